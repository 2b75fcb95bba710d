"""Sweeps: grids read or refused by name, runs shared out, skipped and gone on with."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from cloak_core.core.events import read_events
from cloak_core.exchange.face_lists import read_colors
from cloak_core.files.errors import InputError
from cloak_core.studies import sweeps
from cloak_core.studies.sweeps import Sweep, read_grid
from tests.core import children
from tests.core.fakes import BrokenDetector
from tests.core.test_training import run as train_alone

BASE = "[base]\nscene = 'sample'\nlogo = 'chest.npy'\nsteps = 4\n"


def grid(tmp_path: Path, text: str) -> list:
    path = tmp_path / "grid.toml"
    path.write_text(text)
    return read_grid(path)


def test_every_combination_in_the_files_order(tmp_path):
    runs = grid(tmp_path, BASE + "tv-weight = 0\n[grid]\nlr = [0.1, 1]\ndetector = ['a', ['b', 'c:d/e.cfg']]\n")
    assert [run.varied for run in runs] == [
        {"lr": 0.1, "detector": "a"},
        {"lr": 0.1, "detector": ["b", "c:d/e.cfg"]},
        {"lr": 1, "detector": "a"},
        {"lr": 1, "detector": ["b", "c:d/e.cfg"]},
    ]
    assert [run.settings.optimization.lr for run in runs] == [0.1, 0.1, 1.0, 1.0]
    assert all(run.settings.objective.tv_weight == 0 and run.settings.run.epochs is None for run in runs)
    assert runs[1].detectors == ("b", "c:d/e.cfg") and runs[1].backgrounds == "procedural:train"
    assert [run.label for run in runs[:2]] == ["lr=0.1, detector=a", "lr=0.1, detector=b+c:d/e.cfg"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"no \[grid\]"),
        (BASE, r"no \[grid\]"),
        ("x = 1\n", "'x' is neither"),
        ("base = 1\n", "'base' is neither"),
        ("[base", "not valid TOML"),
        (BASE + "[grid]\nlr = 0.1\n", r"\[grid\] lr: a list"),
        (BASE + "[grid]\nlr = []\n", r"\[grid\] lr: a list"),
        (BASE + "[grid]\nlr = [0.1, 0.1]\n", r"lr: 0\.1 stands there twice"),
        (BASE + "[grid]\nsteps = [1, 2]\n", r"'steps' stands in \[base\] and in \[grid\]"),
        (BASE + "[grid]\ncolour = [1]\n", "--colour: no such setting"),
        (BASE + "[grid]\nlr = [0.1, nan]\n", "--lr: nan"),
        (BASE + "[grid]\nbatch = [8, -3]\n", "--batch: -3"),
        (BASE + "[grid]\ndistance = ['2', '3:1']\n", "--distance: '3:1' is an inverted range"),
        (BASE + "[grid]\nmomentum = [0.9]\n", "--momentum: Adam"),
        (BASE + "[grid]\ndetector = [1]\n", "detector"),
        (BASE + "[grid]\ndetector = [[]]\n", "detector: none"),
        (BASE + "[grid]\ndetector = ['a', ['a', 'b'], ['a', 'b']]\n", r"\['a', 'b'\] stands there twice"),
        (BASE + "[grid]\nscene2 = ['a']\n", "--scene2"),
        (BASE + "tv_weight = 0\ntv-weight = 1\n[grid]\nlr = [1]\n", "a name stands there twice"),
        (BASE + "[grid]\npreset = ['best', ['paper']]\n", "--preset"),
        ("[base]\nscene = 'a'\n[grid]\nlr = [1]\n", "logo is missing"),
        (BASE + f"[grid]\nseed = {[*range(2000)]}\nbatch = {[*range(1, 102)]}\n", "202000 runs, more than"),
    ],
)  # fmt: skip
def test_bad_grids_are_refused_by_name(tmp_path, text, words):
    with pytest.raises(InputError, match=words) as refused:
        grid(tmp_path, text)
    assert "grid.toml" in str(refused.value) and "\n" not in str(refused.value)


@pytest.fixture
def runs(tmp_path, monkeypatch):
    """Four tiny runs, on the fakes' material."""
    monkeypatch.setattr(sweeps, "open_run", children.tiny_material)
    return children.tiny_runs(tmp_path)


@pytest.mark.slow
def test_a_sweep_is_its_runs_and_does_nothing_twice(tmp_path, runs):
    heard, said = [], []
    sweep = Sweep(runs, tmp_path / "out")
    assert sweep.run(said.append, heard.append) == ""
    record = sweep.write_results()
    assert (record["runs"], record["done"]) == (4, 4)
    assert [r["varied"] for r in record["results"]] == [run.varied for run in runs]
    assert said.pop(0) == "4 of 4 runs to train"
    assert said[0].startswith("run 1 of 4: lr=0.02, seed=0: ") and said[0].endswith(" left") and len(said) == 4
    assert said[-1].startswith("run 4 of 4: ") and "left" not in said[-1]
    for run, result in zip(runs, record["results"], strict=True):
        alone = train_alone(tmp_path / "alone" / run.label, steps=4, **run.varied)
        assert np.array_equal(read_colors(tmp_path / "out" / result["out"] / "colors.npy"), alone.colors)
        steps = [e for e in read_events(tmp_path / "out" / result["out"] / "events.jsonl") if e["type"] == "step"]
        assert result["loss"] == pytest.approx(steps[-1]["loss"], abs=1e-6) and result["step"] == 4
    assert json.loads((tmp_path / "out" / "sweep.json").read_text()) == record
    lines = (tmp_path / "out" / "sweep.md").read_text().splitlines()
    assert len(lines) == 6 and lines[0].startswith("| lr | seed | steps |") and lines[2].startswith("| 0.02 | 0 | 4 |")
    heard.clear()
    assert Sweep(runs, tmp_path / "out").run(on_event=heard.append) == ""
    assert heard == []


@pytest.mark.slow
def test_what_was_made_of_other_content_is_not_taken_for_done(tmp_path, runs, monkeypatch):
    before = Sweep(runs[:1], tmp_path / "out")
    before.run()
    same = sweeps.open_run

    def edited(run):
        bodies, *others = same(run)
        return dataclasses.replace(bodies, face_colors=bodies.face_colors[::-1]), *others

    monkeypatch.setattr(sweeps, "open_run", edited)
    after = Sweep(runs[:1], tmp_path / "out")
    assert after.results() == []
    after.run()
    colors = [read_colors(sweep.folders[0] / "colors.npy") for sweep in (before, after)]
    assert before.folders != after.folders and not np.array_equal(*colors)
    assert [result["name"] for result in after.write_results()["results"]] == [after.folders[0].name]
    assert before.write_results()["done"] == 1  # what is as it was is found again


@pytest.mark.slow
def test_a_stopped_sweep_goes_on_where_it_was(tmp_path, runs):
    def stop(event):
        running = next(folder for folder in (tmp_path / "out" / "runs").iterdir() if "seed=1" in folder.name)
        if event["type"] == "step" and event["step"] == 2:
            (running / "cancel").touch()

    sweep = Sweep(runs[1:], tmp_path / "out")
    assert sweep.run(on_event=stop) == "stopped in run lr=0.02, seed=1, at step 2: cancel file"
    assert sweep.write_results()["done"] == 0
    heard = []
    assert Sweep(runs, tmp_path / "out").run(on_event=heard.append) == ""
    assert [e["step"] for e in heard if e["type"] == "resume"] == [2]
    assert len([e for e in heard if e["type"] == "step"]) == 14


@pytest.mark.slow
def test_a_failed_run_is_named_the_others_go_on_and_it_is_tried_again(tmp_path, runs, monkeypatch):
    sound = sweeps.open_run

    def broken(run):
        bodies, logo, detectors, backgrounds = sound(run)
        return bodies, logo, [BrokenDetector(2)] if run is runs[1] else detectors, backgrounds

    monkeypatch.setattr(sweeps, "open_run", broken)
    sweep = Sweep(runs, tmp_path / "out")
    assert sweep.run() == ""
    record = sweep.write_results()
    assert record["done"] == 3 and "not finite" in record["results"][1]["error"]
    assert "failed: " in (tmp_path / "out" / "sweep.md").read_text()
    heard = []
    Sweep(runs, tmp_path / "out").run(on_event=heard.append)
    assert [e["step"] for e in heard if e["type"] == "resume"] == [1]  # it alone, from where it had failed
    assert "error" in sweep.results()[1]


def test_a_grid_that_cannot_be_opened_is_refused_before_anything_is_trained(tmp_path):
    text = BASE.replace("chest.npy", str(tmp_path / "absent.npy")) + "[grid]\nlr = [1]\n"
    with pytest.raises(InputError, match=r"absent\.npy"):
        Sweep(grid(tmp_path, text), tmp_path / "out").run()
    assert not (tmp_path / "out").exists()
