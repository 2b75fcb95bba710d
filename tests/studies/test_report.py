"""The report: whole, offline, honest about what is not there, and safe from what others put into a run."""

import itertools
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.files.errors import InputError
from cloak_core.products.run_report import make_report
from cloak_core.studies.report import plots
from cloak_core.studies.report.page import _environment, page_style
from cloak_core.studies.report.words import duration, instead, interval, most_named, percent, short_name
from cloak_core.studies.trained_run import History
from tests.sources.photographs.test_coco_reader import with_value
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

    def handle_startendtag(self, tag: str, attrs: list) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag


def macros() -> object:
    return _environment().get_template("macros.html").module


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


def test_report_without_evaluation_says_so(tmp_path: Path) -> None:
    text = make_report(write_run(tmp_path / "run")).read_text("utf-8")
    parse(text)
    assert "has not been evaluated" in text
    assert "Attack success" not in text
    assert "Success on training images" in text  # the curves are there
    (tmp_path / "run/events.jsonl").unlink()
    assert "logged no steps" in make_report(tmp_path / "run").read_text("utf-8")


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


@pytest.mark.slow
def test_several_detectors_and_warnings(tmp_path: Path) -> None:
    specs = ("builtin", "darknet:/x/tiny.cfg:/x/tiny.weights@224")
    run = write_run(tmp_path / "run", results=made_results(specs=specs))
    path = run / "evaluation/summary.json"
    more = {"unseen": {"bodies": False, "backgrounds": None}, "warnings": ["2 of the bodies were in the training set"]}
    path.write_text(json.dumps(json.loads(path.read_text()) | more))
    text = make_report(run).read_text("utf-8")
    parse(text)
    assert "darknet tiny @224" in text
    assert "bodies seen in training" in text and "backgrounds: not known" in text
    assert "2 of the bodies were in the training set" in text


def test_damaged_evaluation_is_named(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", results=made_results())
    (run / "evaluation" / "scores.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"scores\.npz"):
        make_report(run)
    assert not (run / "report.html").exists()
    with pytest.raises(InputError, match="not a run folder"):
        make_report(tmp_path)


@pytest.mark.slow
def test_pictures_stay_in_their_folder(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", results=made_results())
    (tmp_path / "secret.png").write_bytes(b"secret")
    path = run / "evaluation/pictures.json"
    pictures = json.loads(path.read_text())
    pictures["flat"]["front"] = "../../../secret.png"
    path.write_text(json.dumps(pictures))
    with pytest.raises(InputError, match=r"secret\.png"):
        make_report(run)


PERCENT = {0.0: "0 %", 1.0: "100 %", 0.964: "96 %", 0.996: "99.6 %", 0.99999: "> 99.9 %", 0.004: "0.4 %", None: "–"}


def test_words() -> None:
    assert {value: percent(value) for value in PERCENT} == PERCENT, "100 % means all"
    assert interval([0.88, 0.994]) == "88 – 99.4 %"
    assert interval([None, None]) == "–"
    assert duration(4.2) == "4.2 s" and duration(75) == "1 min 15 s" and duration(3700) == "1 h 1 min"
    assert short_name("builtin") == "builtin"
    assert short_name("darknet:/a/b/yolo.v2.cfg:/a/b/x.weights@224") == "darknet yolo.v2 @224"
    assert short_name("torchvision:fasterrcnn_resnet50_fpn") == "torchvision fasterrcnn_resnet50_fpn"
    assert short_name("python:detectors/d2go.py:load") == "python d2go"


@pytest.mark.slow
def test_a_turntable_in_the_run_or_the_evaluation_turns_in_the_report(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", results=made_results())
    assert "All around" not in make_report(run).read_text("utf-8")
    Image.new("RGB", (4, 4), "red").save(run / "evaluation/pictures/turntable.gif")
    pictures = json.loads((run / "evaluation/pictures.json").read_text())
    (run / "evaluation/pictures.json").write_text(json.dumps(pictures | {"turntable": "turntable.gif"}))
    text = make_report(run).read_text("utf-8")
    parse(text)
    assert text.count("data:image/gif;base64,") == 1 and "All around" in text
    (run / "evaluation/pictures/turntable.gif").unlink()
    Image.new("RGB", (5, 5), "blue").save(run / "turntable.gif")  # the user's own stands for it
    assert "data:image/gif;base64," in make_report(run).read_text("utf-8")


def test_the_report_says_which_colours_there_may_be():
    settings = {"colors_at_most": 8, "pattern": "camouflage", "feature_cm": 2.0}
    config = {"settings": settings, "palette": None, "profile": {"sha256": "0"}}
    facts = lambda config: macros().facts(config, History())
    said = "at most 8 distinct, learnt; patches of at least 2 cm; as they are printed and photographed"
    assert f"<dt>colours</dt><dd>{said}</dd>" in facts(config)
    config = {"settings": {"colors_at_most": 3, "pattern": "free"}, "palette": {"colors": 12}}
    assert "<dd>at most 3 distinct, of a palette of 12</dd>" in facts(config)
    assert "colours" not in facts({"settings": {"pattern": "free"}})


def test_the_headline_says_both_thresholds_and_which_box(tmp_path: Path) -> None:
    rates = {"success": 0.25, "success_own": 0.0, "ci95": [0.2, 0.31], "n": 336}
    clothing = {"success": 0.02, "success_own": 0.0}
    summary = {
        "detectors": {"builtin": {"logo": rates, "clothing": clothing, "by_body": {"a": {}, "b": {}}}, "x": {}},
        "operating_points": {"builtin": 0.3},
        "settings": {"threshold": 0.6},
        "white_box": {"builtin": False},
    }
    lede = macros().lede
    said = lede(summary)
    assert "builtin (black box: never trained against it) finds no person in 0 % above 0.3" in said
    assert "and in 25 % above 0.6 (95 % interval 20 – 31 %), of 336 images of 2 bodies" in said
    assert "in 0 % and 2 % of the same images" in said and said.endswith("Below are 1 more detector.")
    del summary["operating_points"], summary["white_box"]
    assert "builtin finds no person in 25 % above 0.6" in lede(summary)


def test_labels_of_several_detectors_stand_apart() -> None:
    boxes = [{"d": d, "x": 100, "y": y, "w": 9, "h": 9, "score": "0.5"} for d, y in enumerate((50, 52, 60, 300))]
    shown = macros().shot({"image": "", "boxes": boxes}, 416, "")
    tops = sorted(float(y) for y in re.findall(r'class="tag" x="98" y="([\d.]+)"', str(shown)))
    assert len(tops) == 4 and all(b - a >= 26 for a, b in itertools.pairwise(tops))


@pytest.mark.slow
def test_single_images_are_not_joined_to_a_trend() -> None:
    results = made_results()
    single = results.images.drop_duplicates(["control", "angle"])
    for images, joined in ((results.images, True), (single, False)):
        figure = plots.evaluation_figures(replace(results, images=images), "builtin", 0.6)["Success by angle"]
        lines = [line for line in figure.axes[0].get_lines() if len(line.get_xdata()) == 5]
        assert lines and all((line.get_linestyle() != "None") == joined for line in lines)


def test_a_headline_says_what_stands_there_instead() -> None:
    rates = {"renamed": 0.61, "named": {"dog": 12, "kite": 1}}
    assert instead(rates) == '; in 61 % something else is reported there, mostly "dog"'
    assert instead({"renamed": 0.0, "named": {}}) == "; nothing else is reported there"
    assert instead({"renamed": None, "named": None}) == instead({}) == most_named({"named": None}) == ""
    assert most_named(rates) == "dog 12, kite 1"


def test_a_curve_of_many_points_is_drawn_by_its_extremes_and_its_running_mean() -> None:
    value = np.zeros(100_000)
    value[54_321] = 9.0
    with page_style():
        figure = plots.training_curves(
            History(losses={"loss": list(zip(np.arange(1e5).tolist(), value.tolist(), strict=True))})
        )
    extremes, mean = figure.axes[0].lines
    assert len(extremes.get_xdata()) <= 2 * plots.MOST_POINTS and extremes.get_ydata().max() == 9.0
    assert mean.get_ydata().max() == pytest.approx(9 / 2000) and len(mean.get_xdata()) <= plots.MOST_POINTS
