"""The report: whole, offline, honest about what is not there, safe from what others put into a run; its pictures."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
import torch

from cloak_core.core.images import ImageSet
from cloak_core.core.pattern import Pattern
from cloak_core.files.errors import InputError
from cloak_core.products.run_report import make_report
from cloak_core.studies.report import plots
from cloak_core.studies.report.pictures import (
    ANGLES,
    BODIES,
    WORST,
    Drawing,
    gallery_trials,
    worst_trials,
    write_shot,
)
from cloak_core.studies.report.plots import success_by_body
from cloak_core.studies.report.style import style
from cloak_core.studies.report.words import interval, percent
from cloak_core.studies.trained_run import History
from tests.core.fakes import RedDetector
from tests.sources.photographs.test_people_files import with_value
from tests.studies.made_evaluation import made_results, write_run

HOSTILE = '<script>alert("1")</script>&'
VOID = {"meta", "img", "br", "link", "input", "hr"}


class Balanced(HTMLParser):
    """Collects tags and checks that every one of them is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.add(tag)
        self.links += [value for key, value in attrs if key in ("href", "src", "xlink:href") and value]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert tag in VOID or (self.open and self.open.pop() == tag)


def parse(text: str) -> Balanced:
    parser = Balanced()
    parser.feed(text)
    assert not parser.open
    return parser


@pytest.mark.slow
def test_report_opens_offline_and_says_what_was_measured(tmp_path: Path) -> None:
    run = write_run(tmp_path / "my run", results=made_results())
    report = make_report(run)
    assert report == run / "report.html"
    text = report.read_text("utf-8")
    parser = parse(text)
    assert "script" not in parser.tags
    assert all(link.startswith(("data:image/", "#")) for link in parser.links)
    assert not re.search(r"url\((?!#)", text) and "@import" not in text
    summary = json.loads((run / "evaluation/summary.json").read_text())
    logo = summary["detectors"]["builtin"]["logo"]
    shown = (percent(logo["success"]), interval(logo["ci95"]), "my run", "unseen bodies", "random colours", "cd" * 32)
    assert all(words in text for words in shown)
    failed = int((made_results().scores("builtin", "logo") > 0.3).sum())
    assert "A box is a person found above 0.3" in text  # what pictures.json was made at, not the asked 0.6
    assert f"still finds a person above 0.3 in {failed} of" in text
    assert text.count("data:image/jpeg") >= 2 * 15 + 4
    assert "not been evaluated" not in text


@pytest.mark.slow
def test_text_of_others_is_escaped(tmp_path: Path) -> None:
    config = {"settings": {"preset": HOSTILE}, "scene": {"name": HOSTILE, "poses": [HOSTILE]}, HOSTILE: HOSTILE}
    results = made_results(specs=(HOSTILE,), bodies=(HOSTILE, "b", "c"), backgrounds=(HOSTILE,) * 30)
    run = write_run(tmp_path / "run", config, results)
    text = make_report(run).read_text("utf-8")
    assert "script" not in parse(text).tags
    assert "&lt;script&gt;" in text


@pytest.mark.parametrize(
    ("file", "place", "value", "words"),
    [
        ("summary", ("settings", "threshold"), "0.6", "settings.threshold: '0.6' is not a number from 0 to 1"),
        ("summary", ("inputs", "bodies"), -1, "inputs.bodies: -1 is not a list"),
        ("summary", ("detectors", "builtin", "random", "ci95"), [[1]], "ci95: [[1]] is not two numbers"),
        ("summary", ("detectors",), {"other": {}}, "detectors has no 'builtin'"),
        ("pictures", ("gallery", 0, "logo", "file"), 2.5, "file: 2.5 is not text"),
        ("pictures", ("worst", "builtin", 0), "text", "'text' is not a record"),
        ("pictures", ("controls", "images", "grey", "scores", "builtin"), "<b>", "'<b>' is not a number"),
    ],
)
def test_another_type_in_a_foreign_run_is_named(tmp_path: Path, file: str, place: tuple, value: object, words: str):
    run = write_run(tmp_path / "run", results=made_results())
    path = run / "evaluation" / f"{file}.json"
    path.write_text(json.dumps(with_value(json.loads(path.read_text()), place, value)))
    with pytest.raises(InputError) as said:
        make_report(run)
    assert str(said.value).startswith(str(path)) and words in str(said.value)


def test_damaged_evaluation_is_named(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", results=made_results())
    (run / "evaluation" / "scores.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"scores\.npz"):
        make_report(run)
    assert not (run / "report.html").exists()
    with pytest.raises(InputError, match="not a run folder"):
        make_report(tmp_path)


def test_a_curve_of_many_points_is_drawn_by_its_extremes_and_its_running_mean() -> None:
    value = np.zeros(100_000)
    value[54_321] = 9.0
    losses = {"loss": list(zip(np.arange(1e5).tolist(), value.tolist(), strict=True))}
    with style():
        figure = plots.training_curves(History(losses=losses))
    extremes, mean = figure.axes[0].lines
    assert len(extremes.get_xdata()) <= 2 * plots.MOST_POINTS and extremes.get_ydata().max() == 9.0
    assert mean.get_ydata().max() == pytest.approx(9 / 2000) and len(mean.get_xdata()) <= plots.MOST_POINTS


MANY = tuple(f"pose {i:03}" for i in range(60))


def test_each_body_is_shown_at_each_angle() -> None:
    poses, angles = np.repeat(np.arange(3), 10), np.tile(np.repeat(np.arange(5) * 5.0 - 10, 2), 3)
    shown = gallery_trials(pd.DataFrame({"pose": poses, "angle": angles}))
    assert len(shown) == BODIES * ANGLES
    assert shown == sorted(shown) and set(np.diff(shown)) == {2}  # the first of the two at each angle


def test_the_worst_ten_in_order_each_in_its_surest_image() -> None:
    score = np.full((1, 4, 20 * len(MANY)), 0.1, np.float32)
    pose = made_results(bodies=MANY, score=score).trials["pose"].to_numpy()
    for rank, body in enumerate((7, 3, 30, 41)):
        score[0, 0, np.flatnonzero(pose == body)[: 8 - 2 * rank]] = 0.9
    score[0, 0, np.flatnonzero(pose == 3)[2]] = 0.97
    rows = made_results(bodies=MANY, score=score).rows("builtin", "logo")
    worst = worst_trials(rows, 0.6)
    assert [int(pose[trial]) for trial, _ in worst] == [7, 3, 30, 41]
    assert [success for _, success in worst] == [0.6, 0.7, 0.8, 0.9]
    assert score[0, 0, worst[1][0]] == np.float32(0.97)
    score[:] = 0.9
    assert len(worst_trials(made_results(bodies=MANY, score=score).rows("builtin", "logo"), 0.6)) == WORST == 10


def test_a_picture_has_its_persons_boxes_above_each_detectors_own_threshold(tmp_path: Path) -> None:
    low, high = RedDetector(), RedDetector()
    image = torch.full((1, 3, 32, 32), 0.5)
    score = write_shot(tmp_path / "a.jpg", image, {"low": low})["scores"]["low"]
    low.operating_point, high.operating_point = score - 0.1, score + 0.1
    boxes = write_shot(tmp_path / "b.jpg", image, {"low": low, "high": high})["boxes"]
    assert boxes["low"] and not boxes["high"]
    images = Mock(spec=ImageSet, **{"compose.return_value": [image]})
    images.judged = lambda answer, views, trials: (answer._replace(scores=0 * answer.scores), None)
    drawing = Drawing(tmp_path, images, {"logo": Mock(spec=Pattern)}, {"low": low})
    assert not drawing.shots(7, ["logo"])["logo"]["boxes"]["low"], "these are somebody else's"


@pytest.mark.long
def test_the_report_shows_them(tmp_path: Path) -> None:
    text = make_report(write_run(tmp_path / "run", results=made_results(bodies=MANY[:6]))).read_text("utf-8")
    assert "Of 6 bodies in their poses" in text and "success 25" in text
    few = make_report(write_run(tmp_path / "few", results=made_results())).read_text("utf-8")
    assert "bodies in their poses" not in few


def test_many_bodies_make_a_curve_of_bounded_size() -> None:
    figure = success_by_body(made_results(bodies=MANY), "builtin", 0.6)
    assert figure.get_figheight() < 6
    for line in figure.axes[0].lines:
        assert len(line.get_ydata()) == 60 and (np.diff(line.get_ydata()) >= 0).all()
