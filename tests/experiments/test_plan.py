"""What an experiment is going to do, and one row of it."""

import json

import pytest

from cloak_core import cli

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
