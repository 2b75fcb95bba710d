"""What an experiment is going to do, and one row of it."""

import json

import pytest

from cloak_core import cli
from cloak_core.commands.reproduce import Reproduce
from cloak_core.experiments.runner import find, paper_rows

FEW = ["--quick", "--steps", "2", "--device", "cpu", "--threads", "1"]


def said(capsys, *words):
    with pytest.raises(SystemExit) as end:
        cli.main([*words])
    return end.value.code or 0, *capsys.readouterr()


@pytest.mark.slow
def test_a_row_that_does_not_exist_names_those_that_do(tmp_path, capsys):
    code, _, err = said(capsys, "reproduce", "table1", "--only", "hat", "--out", str(tmp_path), *FEW)
    assert code == 2 and "--only hat: no such row (1 letter G, single, builtin;" in err
    code, _, err = said(capsys, "reproduce", "all", "--only", "1", "--out", str(tmp_path), *FEW)
    assert code == 2 and "--only: names rows of one experiment" in err
    code, _, err = said(capsys, "reproduce", "table1", "--only", "1", "--publish", str(tmp_path / "d"), *FEW)
    assert code == 2 and "--publish: takes whole experiments" in err and not (tmp_path / "d").exists()


@pytest.mark.long
def test_one_row_is_made(tmp_path, capsys):
    code, out, err = said(capsys, "reproduce", "single-angle", "--only", "1", "--out", str(tmp_path), "--json", *FEW)
    assert code == 0, err
    (row,) = json.loads(out)["rows"]
    assert 0 <= row["success"] <= 1 and "1 of 1: builtin" in err


@pytest.mark.slow
def test_rows_are_listed_with_their_times(tmp_path, capsys):
    code, out, err = said(capsys, "reproduce", "table1", "--list", "--out", str(tmp_path), "--json", *FEW)
    assert code == 0, err
    rows = json.loads(out)["plan"]["table1"]
    assert [row["number"] for row in rows] == list(range(1, len(rows) + 1)) and len(rows) > 4
    assert any("smiley" in row["name"] and "multi" in row["name"] for row in rows)
    assert all(row["updates"] == 2 and row["seconds"] > 0 for row in rows)
    assert not list(tmp_path.glob("runs/*"))


def test_a_row_is_shown_beside_the_papers(capsys):
    row = {"logo": "smiley", "training": "single", "detector": "builtin", "success": 0.5, "low": 0.4, "high": 0.61}
    paper = paper_rows(find("table1"), [row])
    assert {told["logo"] for told in paper} == {"smiley"} and len(paper) == 2
    Reproduce(name="table1").show({"experiments": {}, "page": "", "rows": [row], "paper": paper})
    lines = [line.strip("│ ").split() for line in capsys.readouterr().out.splitlines()]
    assert ["success", "│", "50", "%"] in lines and ["single", "│", "98", "%", "│", "51", "%"] in lines
