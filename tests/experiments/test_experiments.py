"""Experiments on tiny images: declarations found, tables written and drawn again, each from end to end (slow)."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from cloak_core.commands.reproduce import Reproduce
from cloak_core.core.logo import area_share
from cloak_core.experiments.declared.defences import beats_adaptive, longest_adaptive
from cloak_core.experiments.logos import PAPER_SHARES, paper_logos, shapes, trimmed
from cloak_core.experiments.options import EXPERIMENTS
from cloak_core.experiments.publish import make_page, publish
from cloak_core.experiments.runner import (
    draw_again,
    experiments,
    find,
    measure,
    measure_part,
    paper_rows,
    run_experiment,
)
from cloak_core.files.errors import InputError
from cloak_core.studies import store, training_store
from cloak_core.studies.store import DataSplit, RunStore
from tests.studies.made_split import Glow, make_options, make_split


@pytest.fixture(scope="module")
def split() -> DataSplit:
    return make_split()


@pytest.fixture(scope="module")
def finished(split: DataSplit, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """A folder in which `transfer` was run, and its record."""
    out = tmp_path_factory.mktemp("out")
    return out, run_experiment("transfer", RunStore(split, make_options(out)))


@pytest.mark.long
def test_transfer_writes_everything(split: DataSplit, finished: tuple[Path, dict], tmp_path: Path) -> None:
    out, record = finished
    folder = out / "transfer"
    assert {p.name for p in folder.iterdir()} == {
        "config.json", "numbers.json", "numbers.csv", "thresholds.csv", "matrix.png", "matrix.svg",
    }  # fmt: skip
    assert json.loads((folder / "numbers.json").read_text()) == json.loads(json.dumps(record))
    with (folder / "numbers.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["trained_on"], row["tested_on"]) for row in rows] == [
        (a, b) for a in split.detectors for b in split.detectors
    ]
    for row in record["rows"]:
        assert 0 <= row["low"] <= row["success"] <= row["high"] <= 1
        assert row["n"] == 2 * 11 * 2 and row["seeds"] == 2  # bodies x angles x seeds
        assert {"clothing", "grey", "random", "stripes", "checks", "clean_detection", "average_precision"} <= row.keys()
    for row, curves in zip(record["rows"], record["thresholds"][::6], strict=True):
        assert curves["control"] == "logo" and curves["at_0.6"] == row["success"]
        assert (curves["trained_on"], curves["tested_on"]) == (row["trained_on"], row["tested_on"])
    config = json.loads((folder / "config.json").read_text())
    assert config["quick"] and config["detectors"].keys() == split.detectors.keys()
    page = make_page(out).read_text("utf-8")
    assert "Transfer between detectors" in page and "Not run yet: table1" in page
    assert 'src="http' not in page and "<script" not in page
    assert publish(out, tmp_path) == tmp_path
    with (tmp_path / "transfer.csv").open() as file:
        published = list(csv.DictReader(file))
    assert [row["success"] for row in published] == [row["success"] for row in rows]
    assert [float(row["at_0.6"]) for row in published] == [row["success"] for row in record["rows"]]


def test_publishing_replaces_the_rows_of_its_study_and_keeps_others(tmp_path: Path) -> None:
    row = {"detector": "onnx:/a/n.onnx@conf=0.4", "success": 0.5, "seeds": 2}
    record = {"title": "t", "words": [], "rows": [row, row | {"success": 0.6}], "counts": {"quick": True}}
    for study in ("first", "second", "first"):
        folder = tmp_path / study / "table1"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "numbers.json").write_text(json.dumps(record))
        (folder / "config.json").write_text(json.dumps({"command": "cloak --scene '/a/b.npz[0:4]'", "torch": "2.14.1"}))
        publish(tmp_path / study, tmp_path / "records")
        record["rows"] = [row | {"worst_seed": None}]
    read = lambda name: (tmp_path / "records" / name).read_text()
    assert read("table1.csv") == (
        "study,detector,success,seeds,worst_seed\nsecond,onnx n @conf=0.4,0.5,2,\nfirst,onnx n @conf=0.4,0.5,2,\n"
    )
    made = "cloak --scene 'b.npz[0:4]',2.14.1,True\n"
    assert read("studies.csv") == f"study,command,torch,quick\ntable1/second,{made}table1/first,{made}"
    (tmp_path / "records" / "table1.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match=r"table1.csv: not a table of studies"):
        publish(tmp_path / "first", tmp_path / "records")


@pytest.mark.slow
def test_figures_come_from_the_numbers_alone(
    finished: tuple[Path, dict], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cloak
) -> None:
    shutil.copytree(finished[0] / "transfer", tmp_path / "transfer")
    drawn_again("transfer", tmp_path)
    # By the command, too, which opens no detector for it. What an early version wrote is left as it is.
    monkeypatch.setattr("cloak_core.detectors.loading.load_detector", lambda *_, **__: pytest.fail("opened"))
    (tmp_path / "shape").mkdir()
    record = json.loads((tmp_path / "transfer/numbers.json").read_text())
    earlier = json.dumps({key: value for key, value in record.items() if key not in ("format", "facts", "pictures")})
    (tmp_path / "shape/numbers.json").write_text(earlier.replace('"transfer-', '"shape-'))
    for file in record["figures"]:
        (tmp_path / "shape" / file).write_bytes((tmp_path / "transfer" / file).read_bytes())
    code, out, _ = cloak("reproduce", "all", "--redraw", "--out", tmp_path, "--json")
    result = json.loads(out)
    assert code == 0 and result["experiments"].keys() == {"transfer"}
    assert result["skipped"].keys() == {"shape"} and (tmp_path / "shape/numbers.json").read_text() == earlier
    code, _, err = cloak("reproduce", "shape", "--redraw", "--out", tmp_path)
    assert code == 2 and "not a cloak experiment" in err


@pytest.mark.long
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_runs(name: str, split: DataSplit, tmp_path_factory: pytest.TempPathFactory) -> None:
    out = tmp_path_factory.getbasetemp() / "experiments"  # one folder, so that they share as they do for users
    if name == "render-gap":  # every frame is a render of Blender's
        split = replace(split, unseen=split.unseen.select_poses([0]), detectors={"red:a.cfg": Glow("red", 0)})
    record = run_experiment(name, RunStore(split, make_options(out, seeds=1)))
    assert record["rows"] and record["words"] == [experiments()[name].caption] and record["figures"]
    json.dumps(record, allow_nan=False)
    assert record["title"] in make_page(out).read_text("utf-8")
    drawn_again(name, out)


def drawn_again(name: str, out: Path) -> None:
    """Figures come back, byte by byte, from numbers.json alone; pictures are no figures, and stay."""
    folder = out / name
    record = (folder / "numbers.json").read_bytes()
    made = [file for file in json.loads(record)["figures"] if not file.endswith(".jpg")]
    before = {file: (folder / file).read_bytes() for file in made}
    assert len(made) >= 2
    for file in (*made, "numbers.csv", "config.json"):
        (folder / file).rename(folder / f"{file}.away")
    draw_again(name, out)
    assert {file: (folder / file).read_bytes() for file in made} == before
    assert (folder / "numbers.json").read_bytes() == record
    for file in ("numbers.csv", "config.json"):
        (folder / f"{file}.away").rename(folder / file)


@pytest.mark.long
def test_logos_have_the_paper_s_shares(split: DataSplit, tmp_path: Path) -> None:
    logos = paper_logos(split.bodies, tmp_path)
    share = lambda name: area_share(split.bodies, logos[name])
    assert share("letter G") == pytest.approx(PAPER_SHARES["letter G"], rel=0.05)
    assert share("smiley") == pytest.approx(PAPER_SHARES["smiley"], rel=0.05)
    assert share("chest + thighs, small") == pytest.approx(PAPER_SHARES["chest + thighs"], rel=0.05)
    assert set(logos["chest + thighs, small"]) < set(logos["chest + thighs"])
    whole = logos["chest + thighs"]
    assert (trimmed(split.bodies, whole, 0.5) == whole).all()
    named = shapes(split.bodies, tmp_path, quick=True)
    assert next(iter(named)) == "disc 1.0%" and len(named) == 5


def attacked(attack: str, success: float, steps: int = 400, logo: str = "chest + thighs") -> dict:
    label = {"detector": "builtin", "logo": logo, "attack": attack, "steps": steps, "trained_on": "builtin"}
    return label | {"success": success, "low": success - 0.05, "high": success + 0.05, "n": 330}


def test_a_masked_gradient_shows_where_less_does_more() -> None:
    same = ("detector", "logo")
    marks = lambda *rows: [row["beats_adaptive"] for row in beats_adaptive(list(rows), same)]
    longest, larger = attacked("adaptive", 0.25), attacked("adaptive", 0.4, logo="shirt + trousers")
    assert longest_adaptive([attacked("adaptive", 0.1, 100), longest, larger], same) == [longest, larger]
    assert marks(attacked("adaptive", 0.12, 100), longest, larger, attacked("random search", 0.05)) == [False] * 4
    assert marks(attacked("adaptive", 0.12, 100), longest, attacked("random search", 0.6)) == [False, False, True]
    assert marks(attacked("adaptive", 0.6, 100), longest) == [True, False]
    assert marks(longest, attacked("transferred", 0.29)) == [False, False]  # within the interval


def test_unknown_experiment(split: DataSplit, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="experiment 'table2': not one of table1"):
        run_experiment("table2", RunStore(split, make_options(tmp_path)))
    with pytest.raises(InputError, match="no finished experiment"):
        make_page(tmp_path)


@pytest.mark.slow
def test_what_the_parts_of_an_experiment_made_is_found_by_the_whole(
    split: DataSplit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_store, transfer = RunStore(split, make_options(tmp_path, seeds=1)), experiments()["transfer"]
    for part in range(3):
        measure_part(transfer, run_store, part, 3)
    for module, name in ((training_store, "train"), (store, "measure_frozen")):
        monkeypatch.setattr(module, name, lambda *given, **more: pytest.fail("made again"))
    assert len(measure(transfer, run_store).rows) == 4


# --- what an experiment is going to do, and one row of it

FEW = ("--quick", "--steps", "2", "--device", "cpu", "--threads", "1")


@pytest.mark.slow
def test_a_row_that_does_not_exist_names_those_that_do(tmp_path, cloak):
    code, _, err = cloak("reproduce", "table1", "--only", "hat", "--out", str(tmp_path), *FEW)
    assert code == 2 and "--only hat: no such row (1 letter G, single, builtin;" in err
    code, _, err = cloak("reproduce", "all", "--only", "1", "--out", str(tmp_path), *FEW)
    assert code == 2 and "--only: names rows of one experiment" in err
    code, _, err = cloak("reproduce", "table1", "--only", "1", "--publish", str(tmp_path / "d"), *FEW)
    assert code == 2 and "--publish: takes whole experiments" in err and not (tmp_path / "d").exists()


@pytest.mark.long
def test_one_row_is_made(tmp_path, cloak):
    code, out, err = cloak("reproduce", "single-angle", "--only", "1", "--out", str(tmp_path), "--json", *FEW)
    assert code == 0, err
    (row,) = json.loads(out)["rows"]
    assert 0 <= row["success"] <= 1 and "1 of 1: builtin" in err


@pytest.mark.slow
def test_rows_are_listed_with_their_times(tmp_path, cloak):
    code, out, err = cloak("reproduce", "table1", "--list", "--out", str(tmp_path), "--json", *FEW)
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
