"""What the trainer is started with: a Python that has it, and settings that can work."""

import re
from pathlib import Path

import bpy
import cloak
import numpy as np
import pytest
from cloak.blender import colors, pictures
from cloak.files.errors import InputError
from cloak.result import try_it
from cloak.session import session
from cloak.trainer import command_lines, program
from cloak.trainer import preferences as preferences_module
from cloak.trainer.command_lines import cloak_command
from cloak.trainer.preferences import preferences, trainer, trainer_reason
from cloak.training.operators import train_reason
from conftest import run_job

# --- the program ------------------------------------------------------------------------------------------------------


def make_program(place: Path, text: str = "exit 0") -> Path:
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(f"#!/bin/sh\n{text}\n")
    place.chmod(0o755)
    return place


@pytest.fixture
def nowhere(monkeypatch, tmp_path) -> Path:
    """A machine without a trainer; returns the user's home."""
    for name in ("CLOAK_PROGRAM", "UV_TOOL_BIN_DIR", "PIPX_BIN_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", "/bin")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    preferences_module._reason.cache_clear()
    preferences().program = ""
    return tmp_path / "home"


@pytest.mark.parametrize(
    "place",
    [".local/bin/cloak", ".local/share/uv/tools/cloak-core/bin/cloak", ".local/pipx/venvs/cloak-core/bin/cloak"],
)
def test_the_program_is_found_where_installers_put_it_and_not_started(nowhere, place, tmp_path):
    with pytest.raises(InputError, match="No trainer found"):
        program.find_program()
    made = make_program(nowhere / place, f"touch '{tmp_path}/started'")
    assert program.find_program() == str(made) and trainer_reason() == ""
    assert cloak_command(str(made), "x") == [str(made), "x", "--json"] and not (tmp_path / "started").exists()


def test_the_line_that_installs_the_trainer_names_the_wheel_that_was_chosen(nowhere):
    preferences().wheel = "~/my wheels/cloak_core-2.0.0-py3-none-any.whl"
    try:
        with pytest.raises(InputError) as error:
            trainer()
        assert str(error.value).endswith(
            f'uv tool install "{nowhere}/my wheels/cloak_core-2.0.0-py3-none-any.whl[onnx]"'
        )
    finally:
        preferences().wheel = ""


def test_what_is_chosen_comes_first(nowhere, tmp_path, monkeypatch):
    make_program(nowhere / ".local/bin/cloak")
    monkeypatch.setenv("CLOAK_PROGRAM", str(make_program(tmp_path / "named")))
    assert program.find_program() == str(tmp_path / "named")
    made = make_program(tmp_path / "checkout/.venv/bin/cloak")
    assert program.find_program(str(tmp_path / "checkout")) == program.find_program(str(made)) == str(made)
    python = make_program(tmp_path / "host-python")
    assert cloak_command(program.find_program(str(python)))[:3] == [str(python), "-m", "cloak_core"]
    for chosen in ("/nowhere/cloak", str(tmp_path)):
        with pytest.raises(InputError, match="cannot be run: choose another"):
            program.find_program(chosen)


def test_without_a_trainer_what_needs_one_is_not_there_and_the_rest_works(ready, nowhere):
    preferences().program = ""
    assert 'uv tool install "PATH/cloak_core-' in trainer_reason()
    shown = {cls.__name__ for cls in cloak.CLASSES if issubclass(cls, bpy.types.Panel) and cls.poll(bpy.context)}
    hidden = {"train", "evaluation", "eye", "wear"}
    assert not shown & {f"CLOAK_PT_{name}" for name in hidden} and {"CLOAK_PT_logo", "CLOAK_PT_result"} <= shown
    with pytest.raises(RuntimeError, match=r"poll\(\).*No trainer found"):
        bpy.ops.cloak.train_start()
    assert not Path(bpy.context.scene.cloak.output).exists()  # nothing half-written
    bpy.ops.cloak.logo_stamp()
    bpy.ops.cloak.copy_install_line()
    bpy.ops.cloak.add_sample_body()
    sample = bpy.context.object
    assert sample.name.startswith("Sample Body") and len(sample.data.polygons) == 13_486
    bpy.ops.cloak.ready_cloak(cloak="builtin-sample")
    assert bpy.context.object is sample and colors.is_dressed(sample)
    assert Path(sample.cloak.run).parent == Path(bpy.context.scene.cloak.output)
    bpy.ops.cloak.bake(size=1024)
    bpy.context.view_layer.objects.active = ready
    bpy.ops.cloak.ready_cloak(cloak="transfer-people")
    assert bpy.context.object not in (sample, ready) and colors.is_dressed(bpy.context.object)


def test_try_it_goes_from_nothing_to_a_picture_before_and_after(stub, tmp_path, monkeypatch, coarse_renders):
    told = []
    monkeypatch.setattr(try_it, "tell_status", told.append)
    bpy.context.scene.cloak.output = str(tmp_path / "runs")
    bpy.ops.cloak.try_it()
    job = run_job(400)
    assert bpy.context.object.cloak.logo == "front", "the chest alone is seen after 100 steps"
    assert {words.partition(":")[0] for words in told} == {"Sample body", "Training", "Render check", ""} and not told[
        -1
    ]
    assert any("Render check 2/" in words for words in told), "how far it is"
    picture = bpy.data.images["0.90 before, 0.10 after: scores, reported from 0.5"]
    before, after = np.split(pictures.image_pixels(picture)[..., :3], 2, axis=1)
    assert before.shape == after.shape == (416, 416, 3) and picture.packed_file
    reddish = [((pixels[..., 0] > 0.6) & (pixels[..., 1] < 0.3)).mean() for pixels in (before, after)]
    assert reddish[0] < 0.01 < reddish[1], "the stub's cloak is red"
    assert (job.label, job.state) == ("Render check", "done"), job.message
    assert [session.job_of(kind).state for kind in ("Sample body", "Training")] == ["done", "done"]
    assert (
        session.job_of("Training").progress.steps == 100
        and bpy.context.scene.view_settings.view_transform == "Standard"
    )
    assert "person detected in 0 of 2 renders with the cloak" in job.message


def test_a_wrong_program_is_said(ready, tmp_path):
    preferences().program = "/nowhere/cloak"
    with pytest.raises(RuntimeError, match="cannot be run"):
        bpy.ops.cloak.train_start()
    assert not Path(bpy.context.scene.cloak.output).exists()
    preferences().program = str(make_program(tmp_path / "empty"))
    bpy.ops.cloak.train_start()
    job = run_job()
    assert job.state == "failed" and "The trainer ended and left no colours in" in job.message


def test_test_says_what_the_trainer_is_or_what_is_wrong(ready, stub, monkeypatch):
    bpy.ops.cloak.test_trainer()
    job = run_job()
    assert preferences().answer == job.message == "Cloak 0.stub, torch 0.stub, Python 3.11.0, CPU"
    monkeypatch.setenv("CLOAK_STUB", "refuse")
    bpy.ops.cloak.test_trainer()
    assert run_job().state == "failed" and preferences().answer == "The trainer does not work: no libtorch.so"


def test_where_no_network_is_allowed_the_trainer_is_told():
    system = bpy.context.preferences.system
    for allowed in (True, False):
        system.use_online_access = allowed
        assert ("CLOAK_OFFLINE" in program.clean_environment()) == (not bpy.app.online_access)


def test_blenders_own_python_settings_do_not_reach_the_trainer(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/blender/scripts")
    monkeypatch.setenv("PYTHONHOME", "/blender")
    assert not {"PYTHONPATH", "PYTHONHOME"} & set(program.clean_environment())


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


def test_files_in_a_detectors_name_become_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a.cfg", "me@home.weights"):
        Path(name).touch()
    made = command_lines.absolute_detector("darknet:a.cfg:me@home.weights@416,letterbox")
    assert made == f"darknet:{tmp_path}/a.cfg:{tmp_path}/me@home.weights@416,letterbox"
    assert command_lines.absolute_detector("torchvision:ssd:none.pth") == "torchvision:ssd:none.pth"
