"""Bounds on a card's figures: read, checked, written for CI."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from cloak_core.commands import assess
from cloak_core.files.errors import InputError
from cloak_core.files.reading import is_number
from cloak_core.studies.card import gate, leaderboard, page
from cloak_core.studies.card.assess import Assessment
from tests.studies.made_split import TINY, Bulb, make_store

CARD = {
    "spec": "builtin",
    "clean": {"recall_own": 0.97, "ci95_own": [0.95, 0.99], "false_alarms_own": None},
    "white_box": [{"asked": 0.05, "success_own": 0.1}, {"asked": 0.2, "success_own": 0.6}],
    "black_box": {"zoo": [{"name": "demo", "success": 0.3}]},
}
BOUNDS = """
[min]
clean.recall_own = 0.95
clean.ci95_own.0 = 0.96
[max]
white_box.5.success_own = 0.3
white_box.20.success_own = 0.3
clean.false_alarms_own = 0.01
black_box.zoo.demo.success = 0.3
"""


def test_each_broken_bound_is_named(tmp_path: Path) -> None:
    (tmp_path / "gate.toml").write_text(BOUNDS)
    bounds = gate.read_gate(tmp_path / "gate.toml")
    said = gate.check(CARD, bounds)
    assert [words for words in said.values() if words] == [
        "builtin: clean.ci95_own.0 is 0.95; the gate asks for clean.ci95_own.0 >= 0.96",
        "builtin: white_box.20.success_own is 0.6; the gate asks for white_box.20.success_own <= 0.3",
        "builtin: clean.false_alarms_own was not measured; the gate asks for clean.false_alarms_own <= 0.01",
    ]
    gate.write_junit(tmp_path / "gate.xml", {"builtin": said})
    (suite,) = ElementTree.parse(tmp_path / "gate.xml").getroot()
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("builtin", "6", "3")
    assert len(suite.findall("testcase/failure")) == 3
    # Control characters, which XML has no way to write, do not break the file.
    gate.write_junit(tmp_path / "gate.xml", {"onnx:a\x1b[31m\0.onnx": {bounds[0]: "below \x07 it"}})
    (case,) = ElementTree.parse(tmp_path / "gate.xml").getroot().iter("testcase")
    assert case.get("classname") == r"onnx:a\x1b[31m\x00.onnx" and case[0].get("message") == r"below \x07 it"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("max = ", "not valid TOML"),
        ("", "holds no bound"),
        ("[most]\na = 1", "expected the tables"),
        ("min = 3", "expected the tables"),
        ("[max]\nclean.recall = 'high'", "'high', not a number"),
        ("[max]\nclean.recall = true", "not a number"),
    ],
)
def test_a_bad_gate_is_one_line_before_anything_is_measured(text: str, said: str, tmp_path: Path, cloak) -> None:
    (tmp_path / "gate.toml").write_text(text)
    code, _, words = cloak("assess", "builtin", "--out", tmp_path / "cards", "--gate", tmp_path / "gate.toml")
    assert code == 2 and said in words and "gate.toml" in words and words.count("\n") == 1
    assert not (tmp_path / "cards").exists()


def test_a_broken_bound_ends_with_1(tmp_path: Path, cloak, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leaderboard, "gather", lambda _: {"builtin": CARD})
    monkeypatch.setattr(page, "write_card", lambda folder: folder / "card.html")
    monkeypatch.setattr(assess.Assess, "show", lambda *_: None)
    (tmp_path / "gate.toml").write_text("[max]\nwhite_box.20.success_own = 0.3")
    call = ["assess", "--out", tmp_path, "--gate", tmp_path / "gate.toml"]
    code, _, err = cloak(*call, "--junit", tmp_path / "gate.xml")
    assert code == 1 and 'failures="1"' in (tmp_path / "gate.xml").read_text()
    assert "builtin: white_box.20.success_own is 0.6" in err
    (tmp_path / "gate.toml").write_text("[max]\nwhite_box.20.success_own = 0.7")
    assert cloak(*call)[0] == 0
    with pytest.raises(InputError, match="--junit: needs --gate"):
        assess.Assess(out=tmp_path, junit=tmp_path / "gate.xml").run()


@pytest.mark.slow
def test_the_expected_card_has_the_figures_of_the_measured_one(made: tuple[Path, dict, list], tmp_path: Path) -> None:
    """In both boxes; what a detector may be renamed to, and the rest that it may not tell, are expected at most."""
    for name, white_box in (("glow", True), ("dark:net.onnx", False)):
        card = made[1] if white_box else page.read_card(made[0] / "dark" / "card.json")
        store = make_store(tmp_path, Bulb(name, white_box))
        expected = Assessment(store, TINY, tmp_path / "x", ["builtin-sample"] if white_box else []).expected()
        numbers, promised = ({p for p, v in gate.flat(c) if is_number(v)} for c in (card, expected))
        assert numbers <= promised and {p.rpartition(".")[2] for p in promised - numbers} <= NAMELESS


NAMELESS = {"renamed", "renamed_own", "gone", "gone_own", "other"}
"""Figures of a detector that tells of other classes."""
PEOPLE = {"named": {"dog": 3}, "success_own": 0.1}


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("clean.recall_own", ""),
        ("white_box.20.named.cat", ""),
        ("circle", ""),
        ("clean.recal_own", "no figure of this card (size quick, no --people); did you mean clean.recall_own?"),
        ("white_box.40.success_own", "did you mean white_box.20.success_own?"),
        ("photographs.rows.cloth.success_own", "no --people"),
        ("spec", "no figure"),
    ],
)
def test_a_key_that_is_no_figure_is_refused(key: str, said: str, tmp_path: Path) -> None:
    card = CARD | {"size": "quick", "circle": None, "white_box": [PEOPLE | {"asked": 0.2}]}
    try:
        gate.require_measured(tmp_path, [gate.Bound(key, "max", 0.5)], card)
        told = ""
    except InputError as error:
        told = str(error)
    assert said in told and bool(said) == bool(told)


def test_nothing_is_measured_under_a_gate_that_cannot_be_held(
    tmp_path: Path, cloak, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Assessment, "run", lambda _: pytest.fail("measured"))
    (tmp_path / "gate.toml").write_text("[max]\nwhite_box.20.success_own = 0.3")
    words = ("--size", "quick", "--out", tmp_path / "cards", "--gate", tmp_path / "gate.toml")
    code, _, err = cloak("assess", "builtin", *words, "--junit", tmp_path / "gate.xml")
    said = "no figure of this card (size quick, no --people); did you mean white_box.76.success_own?"
    assert code == 2 and said in err.replace("\n", " ")
    assert not (tmp_path / "gate.xml").exists()
