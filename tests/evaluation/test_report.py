"""The report: whole, offline, honest about what is not there, and safe from what others put into a run."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from made_evaluation import make_measurement, write_run
from PIL import Image

from cloak_core.evaluation.report.history import History
from cloak_core.evaluation.report.page import make_report
from cloak_core.evaluation.report.words import duration, fact_rows, interval, percent, short_name
from cloak_core.files.errors import InputError

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


def parse(text: str) -> Balanced:
    parser = Balanced()
    parser.feed(text)
    assert not parser.open
    return parser


@pytest.mark.slow
def test_report_opens_offline_and_says_what_was_measured(tmp_path: Path) -> None:
    run = write_run(tmp_path / "my run", measurement=make_measurement())
    report = make_report(run)
    assert report == run / "report.html"
    text = report.read_text("utf-8")
    parser = parse(text)
    assert "script" not in parser.tags
    assert all(link.startswith(("data:image/", "#")) for link in parser.links)
    assert not re.search(r"url\((?!#)", text) and "@import" not in text
    summary = json.loads((run / "evaluation/summary.json").read_text())
    logo = summary["detectors"]["builtin"]["logo"]
    for shown in (
        percent(logo["success"]),
        interval(logo["ci95"]),
        "my run",
        "unseen bodies",
        "random colours",
        "cd" * 32,
    ):
        assert shown in text
    assert text.count("data:image/jpeg") >= 2 * 15 + 4
    assert "not been evaluated" not in text


def test_report_without_evaluation_says_so(tmp_path: Path) -> None:
    text = make_report(write_run(tmp_path / "run")).read_text("utf-8")
    parse(text)
    assert "has not been evaluated" in text
    assert "Attack success" not in text
    assert "Success on training images" in text  # the curves are there


def test_report_of_a_run_without_events(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run")
    (run / "events.jsonl").unlink()
    assert "logged no steps" in make_report(run).read_text("utf-8")


@pytest.mark.slow
def test_text_of_others_is_escaped(tmp_path: Path) -> None:
    config = {"settings": {"preset": HOSTILE}, "scene": {"name": HOSTILE, "poses": [HOSTILE]}, HOSTILE: HOSTILE}
    measurement = make_measurement(specs=(HOSTILE,), bodies=(HOSTILE, "b", "c"))
    object.__setattr__(measurement, "background_names", (HOSTILE,) * 30)
    run = write_run(tmp_path / "run", config, measurement)
    text = make_report(run).read_text("utf-8")
    assert "script" not in parse(text).tags
    assert "&lt;script&gt;" in text


@pytest.mark.slow
def test_several_detectors_and_warnings(tmp_path: Path) -> None:
    run = write_run(
        tmp_path / "run", measurement=make_measurement(specs=("builtin", "darknet:/x/tiny.cfg:/x/tiny.weights@224"))
    )
    path = run / "evaluation/summary.json"
    summary = json.loads(path.read_text())
    summary |= {
        "unseen": {"bodies": False, "backgrounds": None},
        "warnings": ["2 of the bodies were in the training set"],
    }
    path.write_text(json.dumps(summary))
    text = make_report(run).read_text("utf-8")
    parse(text)
    assert "darknet tiny @224" in text
    assert "bodies seen in training" in text and "backgrounds: not known" in text
    assert "2 of the bodies were in the training set" in text


def test_no_run_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a run folder"):
        make_report(tmp_path)


def test_damaged_evaluation_is_named(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", measurement=make_measurement())
    (run / "evaluation" / "scores.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"scores\.npz"):
        make_report(run)
    assert not (run / "report.html").exists()


@pytest.mark.slow
def test_pictures_stay_in_their_folder(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", measurement=make_measurement())
    (tmp_path / "secret.png").write_bytes(b"secret")
    path = run / "evaluation/pictures.json"
    pictures = json.loads(path.read_text())
    pictures["flat"]["front"] = "../../../secret.png"
    path.write_text(json.dumps(pictures))
    with pytest.raises(InputError, match=r"secret\.png"):
        make_report(run)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0 %"),
        (1.0, "100 %"),
        (0.964, "96 %"),
        (0.996, "99.6 %"),
        (0.99999, "> 99.9 %"),
        (0.004, "0.4 %"),
        (None, "–"),
    ],
)
def test_percent_never_rounds_up_to_all(value: float | None, text: str) -> None:
    assert percent(value) == text


def test_words() -> None:
    assert interval([0.88, 0.994]) == "88 – 99.4 %"
    assert interval([None, None]) == "–"
    assert duration(4.2) == "4.2 s" and duration(75) == "1 min 15 s" and duration(3700) == "1 h 1 min"
    assert short_name("builtin") == "builtin"
    assert short_name("darknet:/a/b/yolo.v2.cfg:/a/b/x.weights@224") == "darknet yolo.v2 @224"
    assert short_name("torchvision:fasterrcnn_resnet50_fpn") == "torchvision fasterrcnn_resnet50_fpn"
    assert short_name("python:detectors/d2go.py:load") == "python d2go"


@pytest.mark.slow
def test_a_turntable_in_the_run_or_the_evaluation_turns_in_the_report(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", measurement=make_measurement())
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
    rows = dict(fact_rows(config, History()))
    assert (
        rows["colours"] == "at most 8 distinct, learnt; patches of at least 2 cm; as they are printed and photographed"
    )
    config = {"settings": {"colors_at_most": 3, "pattern": "free"}, "palette": {"colors": 12}}
    assert dict(fact_rows(config, History()))["colours"] == "at most 3 distinct, of a palette of 12"
    assert "colours" not in dict(fact_rows({"settings": {"pattern": "free"}}, History()))
