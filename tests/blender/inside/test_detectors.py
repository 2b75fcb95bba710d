"""Detectors by their files: several, each with its threshold, checked once, used by every button."""

import json
import os
from pathlib import Path

import bpy
import pytest
from cloak.files.errors import InputError
from cloak.properties import train_options
from cloak.training import detectors, operators, panel
from conftest import drawn, folder_of, run_job


@pytest.fixture
def files(tmp_path) -> dict[str, str]:
    names = ("net v8.onnx", "net.pt", "shop.xml", "pose.tflite", "lite.cfg", "lite_final.weights", "own.py", "a.txt")
    for name in names:
        (tmp_path / name).touch()
    return {Path(name).suffix: str(tmp_path / name) for name in names}


def add(*paths: str) -> None:
    """Through the browser's operator, as a click on its button does."""
    folder = os.path.dirname(paths[0])
    bpy.ops.cloak.detector_add(directory=folder, files=[{"name": os.path.basename(path)} for path in paths])


def said() -> str:
    """What the panel says of the chosen detector."""
    return " ".join(drawn(panel.CLOAK_PT_train))


def test_every_family_is_known_by_its_suffix(ready, files):
    settings = bpy.context.scene.cloak
    assert detectors.trained_against(settings) == detectors.judges(settings) == ("builtin",)
    add(*(files[suffix] for suffix in (".onnx", ".pt", ".xml", ".tflite", ".py")))
    add(files[".cfg"])
    assert [d.bare for d in settings.detectors] == [
        f"onnx:{files['.onnx']}",
        f"ultralytics:{files['.pt']}",
        f"openvino:{files['.xml']}",
        f"tflite:{files['.tflite']}",
        f"python:{files['.py']}:load",
        f"darknet:{files['.cfg']}:{files['.weights']}",
    ]
    for path, words in ((files[".txt"], "ends in .onnx"), ("/none.onnx", "does not exist")):
        with pytest.raises(RuntimeError, match=words):
            add(path)
    os.remove(files[".onnx"])
    with pytest.raises(InputError, match=r"Detector > File: .*net v8.onnx does not exist"):
        train_options(settings)


def test_what_the_check_found_stands_in_the_list(ready, files, monkeypatch):
    settings = bpy.context.scene.cloak
    add(files[".onnx"])
    job = run_job()
    onnx = settings.detectors[0]
    assert job.state == "done" and not job.is_bad_news and onnx.works
    assert onnx.answer == "works: reports from 0.25, scores within 3e-06 of its own runtime"
    assert onnx.threshold == pytest.approx(0.25) and onnx.full == f"onnx:{files['.onnx']}@conf=0.25"
    onnx.options = "640,person=1"
    assert not onnx.checked, "another size is another detector"
    assert onnx.full == f"onnx:{files['.onnx']}@640,person=1,conf=0.25"
    monkeypatch.setenv("CLOAK_STUB", "bad-detector")
    bpy.ops.cloak.detector_check()
    job = run_job()
    assert job.is_bad_news and not onnx.works and onnx.answer == "fails: gradient, batch"
    monkeypatch.setenv("CLOAK_STUB", "refuse")
    bpy.ops.cloak.detector_check()
    assert run_job().state == "failed" and "no such thing here" in onnx.answer


def test_what_gives_no_gradients_only_judges_and_the_panel_says_why(ready, files, monkeypatch):
    settings = bpy.context.scene.cloak
    add(files[".xml"], files[".tflite"])
    with pytest.raises(InputError, match="All detectors only judge"):  # before they are checked
        train_options(settings)
    run_job()
    shop = settings.detectors[0]
    assert shop.works and shop.answer == "works: reports from 0.25 (assumed)"
    add(files[".onnx"])
    run_job()
    net = settings.detectors[2]
    assert not net.only_judges and detectors.trained_against(settings) == (net.full,)
    assert detectors.judges(settings) == (net.full, shop.full, settings.detectors[1].full)
    monkeypatch.setenv("CLOAK_STUB", "black-box")
    bpy.ops.cloak.detector_check()
    run_job()
    assert net.works and net.only_judges and not net.judges
    settings.detector_index = 2
    assert panel.BLACK_BOX in said()
    net.options = "640"
    assert not net.only_judges, "another size is another detector"
    assert panel.BLACK_BOX not in said()


def test_every_button_uses_the_list(dressed, files):
    settings = bpy.context.scene.cloak
    add(files[".onnx"], files[".pt"])
    run_job()
    onnx, ultra = settings.detectors
    ultra.judges, ultra.threshold = True, 0.4
    both = [f"--detector=onnx:{files['.onnx']}@conf=0.25", f"--detector=ultralytics:{files['.pt']}@conf=0.4"]
    assert [w for w in train_options(settings) if "detector" in w] == both[:1]
    bpy.ops.cloak.evaluate()
    run_job()
    words = json.loads((folder_of(dressed) / "evaluation/asked.json").read_text())
    assert [word for word in words if word.startswith("--detector")] == both
    onnx.judges = True
    with pytest.raises(InputError, match="All detectors only judge"):
        train_options(settings)


def test_a_file_of_version_0_1_asks_for_its_detector(ready, files, tmp_path):
    """It named one detector, which the list does not have: nothing trains or judges with another one meanwhile."""
    bpy.context.scene.cloak.detector = 1
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "old.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "old.blend"))
    settings = bpy.context.scene.cloak
    asks = "This file of version 0.1 names a detector of its own: add it, or the built-in one"
    assert operators.train_reason(bpy.context) == asks
    assert "Built-in" not in said()
    for operator in (bpy.ops.cloak.train_start, bpy.ops.cloak.eye):
        with pytest.raises(RuntimeError, match=asks):
            operator()
    bpy.ops.cloak.detector_add_named()
    run_job()
    assert not operators.train_reason(bpy.context)
    assert detectors.trained_against(settings) == ("builtin@conf=0.25",)
