"""Training through Blender, with the Blender that tools/setup_blender.sh brings."""

import json
from pathlib import Path

import numpy as np
import pytest

from cloak_core.commands.demo import REGION, Demo, follow, train_in_blender
from cloak_core.core.events import read_events
from cloak_core.core.logo import select_region
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.face_lists import write_face_list
from cloak_core.exchange.scenes import write_scene
from cloak_core.files.errors import InputError
from cloak_core.products.run_report import make_report
from cloak_core.sources.bodies.blender.outside import ROOT, find_bpy
from cloak_core.sources.bodies.people.samples import sample_bodies

RED = ROOT / "tests" / "blender" / "inside" / "red_detector.py"


@pytest.fixture(scope="module")
def blender() -> str:
    python = find_bpy()
    assert python, "no Python with bpy: run tools/setup_blender.sh"
    return python


def write_wall(folder: Path) -> None:
    """A square of four triangles that faces the camera, with its left half as a region."""
    points = np.array([[[-0.5, 0, 0], [0.5, 0, 0], [0.5, 1, 0], [-0.5, 1, 0], [0, 0.5, 0]]], np.float32)
    triangles = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)
    write_scene(folder, Bodies(points, triangles, regions={"left": np.array([False, False, False, True])}, name="Wall"))


@pytest.mark.long
def test_a_scene_goes_through_blender_and_the_report_shows_it(blender: str, tmp_path: Path) -> None:
    write_wall(tmp_path / "scene")
    (tmp_path / "settings.toml").write_text(
        'tv_weight = 0\nlr = 0.1\nbatch = 2\nschedule = "constant"\nsize = 64\ntranslation = 0\npreview_every = 0\n'
    )
    words = ["--scene", str(tmp_path / "scene"), "--logo", "left", "--steps", "8", "--angles", "0:0:1"]
    words += ["--detector", f"python:{RED}:load", "--backgrounds", "procedural:train:2"]
    words += ["--config", str(tmp_path / "settings.toml")]
    run = tmp_path / "run"
    train_in_blender(blender, words, run)
    assert np.allclose(np.load(run / "colors.npy"), [[1, 0, 0]], atol=1e-6)
    assert (run / "blender.png").read_bytes().startswith(b"\x89PNG")
    assert "In Blender" in make_report(run).read_text("utf-8")
    with pytest.raises(InputError, match="exists already"):
        train_in_blender(blender, words, run)


@pytest.mark.long
def test_the_demo_begins_in_blender_and_goes_on_there(blender: str, tmp_path: Path) -> None:
    bodies = sample_bodies("train")
    write_face_list(tmp_path / "demo-logo.npy", select_region(bodies, REGION), bodies.topology)
    demo = Demo(out=tmp_path / "demo", steps=2)
    for _ in range(2):
        demo._train(tmp_path / "demo-logo.npy", bodies.pose_count)
        steps = [event["step"] for event in read_events(demo.out / "events.jsonl") if event["type"] == "step"]
        assert steps == [1, 2]


@pytest.mark.slow
def test_what_it_says_of_bad_input_comes_through(blender: str, tmp_path: Path) -> None:
    write_wall(tmp_path / "scene")
    with pytest.raises(InputError, match="'Wall' has no logo 'hat'"):
        train_in_blender(blender, ["--scene", str(tmp_path / "scene"), "--logo", "hat"], tmp_path / "run")


def test_events_are_told_once_and_old_ones_not_again(tmp_path: Path) -> None:
    log, told = tmp_path / "events.jsonl", []
    line = lambda kind, step: json.dumps({"type": kind, "step": step, "steps": 9}) + "\n"
    log.write_text(line("start", 0) + line("step", 1))
    answers = iter([True, False])

    def running() -> bool:
        with log.open("a") as file:
            file.write(line("resume", 1) + line("step", 2) + '{"type": "st')
        return next(answers)

    follow(log, running, told.append)
    assert [event["step"] for event in told if event["type"] == "step"] == [2]
    assert [event["step"] for event in told if event["type"] == "start"] == [0, 1]
    assert {event["type"] for event in told} == {"start", "step"}


def test_an_installed_demo_names_no_script_of_the_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr("cloak_core.commands.demo.SCRIPT", tmp_path / "train.py")
    monkeypatch.setattr("cloak_core.commands.demo.Train.run", lambda _: None)
    Demo(out=tmp_path / "demo")._train(tmp_path / "logo.npy", 1)
    said = capsys.readouterr().err
    assert "no picture from it" in said and "tools/" not in said
