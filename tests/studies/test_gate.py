"""Bounds on a card's figures: read, checked, written for CI."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from cloak_core.cli import main
from cloak_core.commands import assess
from cloak_core.files.errors import InputError
from cloak_core.studies.card import gate, leaderboard, page

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


def test_a_cloak_that_was_trained_too_briefly_keeps_no_bound(tmp_path: Path) -> None:
    (tmp_path / "gate.toml").write_text(
        "[min]\naround.success = 0.1\n[max]\nwhite_box.5.success_own = 0.3\ncircle = 0.3\n"
    )
    rows = [{"asked": 0.05, "success_own": 0.1, "steps": 12}]
    card = CARD | {"white_box": rows, "circle": 0.2, "around": {"success": 0.2, "steps": 299}, "counts": {"steps": 150}}
    said = [words for words in gate.check(card, gate.read_gate(tmp_path / "gate.toml")).values() if words]
    few = "is 0.1 after 12 updates of the cloak, too few to say"
    assert said == [f"builtin: white_box.5.success_own {few}; the gate asks for white_box.5.success_own <= 0.3"]
    card["around"]["steps"] = 149
    said = [words for words in gate.check(card, gate.read_gate(tmp_path / "gate.toml")).values() if words]
    assert len(said) == 2 and "circle is 0.2 after 149 updates" in said[1]


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
def test_a_bad_gate_is_one_line_before_anything_is_measured(
    text: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "gate.toml").write_text(text)
    with pytest.raises(SystemExit, match="2"):
        main(["assess", "builtin", "--out", str(tmp_path / "cards"), "--gate", str(tmp_path / "gate.toml")])
    words = capsys.readouterr().err
    assert said in words and "gate.toml" in words and words.count("\n") == 1 and not (tmp_path / "cards").exists()


def test_a_broken_bound_ends_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leaderboard, "gather", lambda _: {"builtin": CARD})
    monkeypatch.setattr(page, "write_card", lambda folder: folder / "card.html")
    monkeypatch.setattr(assess.Assess, "show", lambda *_: None)
    (tmp_path / "gate.toml").write_text("[max]\nwhite_box.20.success_own = 0.3")
    call = ["assess", "--out", str(tmp_path), "--gate", str(tmp_path / "gate.toml")]
    with pytest.raises(SystemExit) as end:
        main([*call, "--junit", str(tmp_path / "gate.xml")])
    assert end.value.code == 1 and 'failures="1"' in (tmp_path / "gate.xml").read_text()
    assert "builtin: white_box.20.success_own is 0.6" in capsys.readouterr().err
    (tmp_path / "gate.toml").write_text("[max]\nwhite_box.20.success_own = 0.7")
    with pytest.raises(SystemExit) as end:
        main(call)
    assert end.value.code == 0
    with pytest.raises(InputError, match="--junit: needs --gate"):
        assess.Assess(out=tmp_path, junit=tmp_path / "gate.xml").run()
