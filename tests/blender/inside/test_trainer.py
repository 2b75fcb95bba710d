"""What the trainer is started with: a Python that has it, and settings that can work."""

import re
import time
from pathlib import Path

import bpy
import pytest
from cloak.files.errors import InputError
from cloak.trainer import command_lines
from cloak.trainer import python as trainer_python
from cloak.trainer.preferences import preferences
from cloak.training.operators import train_reason
from conftest import run_job

# --- its Python -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("python", "words"), [("/nowhere/python", "cannot be run"), ("/bin/true", "no cloak_core")])
def test_missing_or_wrong_python(ready, python, words, tmp_path):
    if python == "/bin/true":  # runs, but is no trainer
        python = str(tmp_path / "python")
        Path(python).write_text("#!/bin/sh\nexit 9\n")
        Path(python).chmod(0o755)
    preferences().python = python
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.cloak.train_start()
    assert not Path(bpy.context.scene.cloak.output).exists()  # nothing half-written


def test_no_python_anywhere(ready, monkeypatch):
    preferences().python = ""
    trainer_python.forget_answers()
    monkeypatch.setattr(trainer_python, "candidates", lambda: [])
    with pytest.raises(RuntimeError, match="choose it in the add-on's preferences"):
        bpy.ops.cloak.train_start()


def test_python_is_found_and_remembered(ready, stub, monkeypatch):
    preferences().python = ""
    trainer_python.forget_answers()
    monkeypatch.setenv("CLOAK_PYTHON", str(stub))
    bpy.ops.cloak.find_python()
    assert preferences().python == str(stub)
    bpy.ops.cloak.test_python()
    job = run_job()
    assert preferences().answer.startswith("Cloak 0.stub, torch 0.stub, Python 3") and "CPU" in job.message
    preferences().python = str(stub)
    bpy.ops.cloak.copy_install_line()
    assert "pip install" in trainer_python.INSTALL_LINE


def test_a_python_that_is_slow_to_answer_keeps_nobody_waiting(ready, tmp_path, monkeypatch):
    """Not eight seconds of a frozen window: the answer comes while the user works."""
    slow = tmp_path / "slow"
    slow.write_text("#!/bin/sh\nsleep 1\nexit 9\n")
    slow.chmod(0o755)
    trainer_python.forget_answers()
    monkeypatch.setattr(trainer_python, "candidates", lambda: [str(slow)])
    start = time.monotonic()
    with pytest.raises(InputError, match="Still looking for a Python with cloak_core"):
        trainer_python.find_python("", 0.05)
    assert trainer_python.find_python(str(slow), 0.05) == str(slow)  # the job itself will say what is wrong
    assert time.monotonic() - start < 0.9
    with pytest.raises(InputError, match="No Python with cloak_core found"):
        trainer_python.find_python()
    with pytest.raises(InputError, match="has no cloak_core"):
        trainer_python.find_python(str(slow))
    slow.write_text("#!/bin/sh\nexit 0\n")  # installed in the meantime
    assert trainer_python.find_python() == trainer_python.find_python(str(slow)) == str(slow)
    trainer_python.forget_answers()


def test_choosing_another_python_raises_nothing(stub, capfd):
    """Blender prints what goes wrong in an update and goes on."""
    preferences().python = "/bin/true"
    assert "Traceback" not in "".join(capfd.readouterr())


def test_test_says_what_is_wrong(ready, stub, monkeypatch, tmp_path):
    bad = tmp_path / "half"
    bad.write_text(
        '#!/bin/sh\ncase "$2" in *find_spec*) exit 0;; esac\necho "ImportError: no libtorch.so" >&2; exit 1\n'
    )
    bad.chmod(0o755)
    preferences().python = str(bad)
    bpy.ops.cloak.test_python()
    run_job()
    assert "no working cloak_core: ImportError: no libtorch.so" in preferences().answer


def test_blenders_own_python_settings_do_not_reach_the_trainer(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/blender/scripts")
    monkeypatch.setenv("PYTHONHOME", "/blender")
    assert not {"PYTHONPATH", "PYTHONHOME"} & set(trainer_python.clean_environment())


# --- settings ---------------------------------------------------------------------------------------------------------


def test_settings_that_cannot_work_are_named(ready, tmp_path):
    settings = bpy.context.scene.cloak
    for change, words in (
        ({"angle_first": 20, "angle_last": 10}, "Angles 20 to 10"),
        ({"backgrounds": str(tmp_path / "none")}, "Backgrounds folder .* does not exist"),
        ({"config": "/x.toml"}, "Settings File: /x.toml does not exist"),
    ):
        before = {key: getattr(settings, key) for key in change}
        for key, value in change.items():
            setattr(settings, key, value)
        with pytest.raises(RuntimeError, match=words):
            bpy.ops.cloak.train_start()
            assert re.search(words, train_reason(bpy.context))
        for key, value in before.items():
            setattr(settings, key, value)


@pytest.mark.parametrize(
    ("spec", "parts"),
    [
        ("builtin", ["builtin"]),
        (r"darknet:C:\nets\a.cfg:D:/a.weights@224", ["darknet", r"C:\nets\a.cfg", "D:/a.weights@224"]),
        ("python:/home/d.py:load", ["python", "/home/d.py", "load"]),
        (r"python:d:\d.py:load", ["python", r"d:\d.py", "load"]),
    ],
)
def test_the_colon_of_a_drive_separates_nothing(monkeypatch, spec, parts):
    asked = []
    monkeypatch.setattr(command_lines, "_absolute_file", lambda part: asked.append(part) or part)
    assert command_lines.absolute_detector(spec) == spec and asked == parts


def test_files_in_a_detectors_name_become_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a.cfg", "me@home.weights"):
        Path(name).touch()
    made = command_lines.absolute_detector("darknet:a.cfg:me@home.weights@416,letterbox")
    assert made == f"darknet:{tmp_path}/a.cfg:{tmp_path}/me@home.weights@416,letterbox"
    assert command_lines.absolute_detector("torchvision:ssd:none.pth") == "torchvision:ssd:none.pth"
