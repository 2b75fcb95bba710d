"""Step 4 with a stub trainer: the panel's way from Start to colours, and everything that may go wrong on it."""

import json
import os
import re
import signal
import subprocess
import threading
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from cloak import body, colors, faces, runs, steps, training_job
from cloak.exchange import InputError
from cloak.preferences import preferences
from cloak.training_job import Job, Progress, TrainingJob, take_event
from conftest import MODULE, blender_command, run_job
from made import make_egg, set_mode

IDS = [10, 20, 30, 333]


@pytest.fixture
def ready(stub, tmp_path):
    """A body with a logo, and settings for a short run into a folder with a difficult name."""
    obj = make_egg()
    faces.new_logo(obj, "Brust/Ärmel", np.isin(np.arange(len(obj.data.polygons)), IDS))
    settings = bpy.context.scene.cloak
    settings.output = str(tmp_path / "Läufe und mehr")
    settings.steps = 20
    return obj


def wait_for(condition, seconds: float = 20) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        training_job.tick()
        time.sleep(0.01)


def red_faces(obj) -> list[int]:
    return np.flatnonzero((np.abs(colors.read_face_colors(obj, "Cloak") - [1, 0, 0]) < 1e-5).all(1)).tolist()


def test_start_to_colours(ready):
    assert steps.train_reason(bpy.context) == ""
    bpy.ops.cloak.train_start()
    job = run_job()
    assert job.state == "done", job.message
    assert "20/20" in job.message
    assert red_faces(ready) == IDS
    run = Path(ready.cloak.run)
    assert run.parent.name == "Läufe und mehr" and "/" not in run.name and "Brust_Ärmel" in run.name
    assert steps.result_reason(bpy.context) == ""
    bpy.ops.cloak.train_start()  # a second run gets a folder of its own
    assert run_job().state == "done" and Path(ready.cloak.run).name == run.name + " 2"


def test_progress_live_colours_and_cancel_then_resume(ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.context.scene.cloak.live_seconds = 0.5
    bpy.ops.cloak.train_start()
    job = training_job.current
    with pytest.raises(RuntimeError, match="Training is running: wait for it, or cancel it"):
        bpy.ops.cloak.train_start()
    with pytest.raises(RuntimeError, match="Training is running"):
        bpy.ops.cloak.heatmap()
    assert "is running" in steps.train_reason(bpy.context)
    wait_for(lambda: job.progress.step >= 3 and "Cloak" in ready.data.color_attributes)
    assert red_faces(ready) == IDS  # while it is still running
    assert job.running and 0 < job.fraction < 1 and "loss" in job.progress.figures() and "left" in job.describe()
    bpy.ops.cloak.train_cancel()
    assert run_job().state == "stopped" and "Resume" in job.message
    reached = int(Path(ready.cloak.run, "step.txt").read_text())
    assert 3 <= reached < 20
    with pytest.raises(RuntimeError, match="Nothing is running"):
        bpy.ops.cloak.train_cancel()
    monkeypatch.setenv("CLOAK_STUB", "")
    bpy.ops.cloak.train_resume()
    assert run_job().state == "done"
    events = [json.loads(line) for line in Path(ready.cloak.run, "events.jsonl").read_text().splitlines()]
    assert [e["step"] for e in events if e["type"] == "step"] == list(range(1, 21))  # went on, did not start over


def test_cancel_before_the_run_folder_exists(ready):
    bpy.ops.cloak.train_start()
    bpy.ops.cloak.train_cancel()
    assert run_job().state in ("stopped", "done")


def test_trainer_killed(ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "die")
    bpy.ops.cloak.train_start()
    job = run_job()
    assert job.state == "failed"
    assert "killed (signal 9)" in job.message and "Resume goes on from the last checkpoint" in job.message
    assert red_faces(ready) == IDS  # what there was is shown
    monkeypatch.setenv("CLOAK_STUB", "")
    bpy.ops.cloak.train_resume()
    assert run_job().state == "done"


@pytest.mark.parametrize(
    ("how", "words"),
    [("refuse", "--detector builtin: no such thing here"), ("crash", "exit code 1.*RuntimeError: a defect")],
)
def test_the_trainers_last_words_reach_the_panel(ready, monkeypatch, how, words):
    monkeypatch.setenv("CLOAK_STUB", how)
    bpy.ops.cloak.train_start()
    job = run_job()
    assert job.state == "failed"
    assert re.search(words, job.message) and "\n" not in job.message
    assert "Cloak" not in ready.data.color_attributes


def test_broken_event_lines_are_passed_over(ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "broken")
    bpy.ops.cloak.train_start()
    job = run_job()
    assert job.state == "done" and job.progress.step == 20
    assert job.progress.broken_lines >= 40


@pytest.mark.parametrize(
    "line",
    [b"", b"{", b"[]", b"3", b"null", b'{"step": 4}', b'{"type": 3}', b"\xff\xfe", b"[" * 100_000, b'{"type": "step"}'],
)
def test_no_line_can_upset_the_progress(line):
    before = Progress(step=3, steps=9, loss=0.5)
    after = take_event(before, line)
    assert (after.step, after.steps, after.loss) == (3, 9, 0.5)


def test_time_left_follows_the_pace():
    progress = take_event(Progress(), b'{"type": "start", "step": 0, "time": 0, "steps": 100}')
    for step in range(1, 11):
        progress = take_event(progress, json.dumps({"type": "step", "step": step, "time": 2.0 * step}).encode())
    assert progress.seconds_left == pytest.approx(180)
    assert "3 min left" in progress.describe()


def test_object_changed_since_export(ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.ops.cloak.train_start()
    body.subdivide(ready)
    job = run_job()
    assert job.state == "done" and "no colours imported: 'Body' changed since export" in job.message
    assert "Cloak" not in ready.data.color_attributes
    with pytest.raises(RuntimeError, match="changed since export"):
        bpy.ops.cloak.train_resume()


def test_object_deleted_or_in_edit_mode_at_the_end(ready):
    bpy.ops.cloak.train_start()
    set_mode("EDIT")
    job = run_job()
    assert "leave Edit Mode (Tab) and press Load Colours" in job.message
    set_mode("OBJECT")
    bpy.ops.cloak.result_load()
    assert red_faces(ready) == IDS
    bpy.ops.cloak.train_start()
    bpy.data.objects.remove(ready)
    assert "the object is gone" in run_job().message


def test_start_leaves_edit_mode_and_takes_what_was_edited(ready):
    set_mode("EDIT")
    bpy.ops.cloak.train_start()
    assert ready.mode == "OBJECT"
    assert run_job().state == "done" and red_faces(ready) == IDS


# --- the trainer's Python --------------------------------------------------------------------------------------------


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
    from cloak import trainer

    preferences().python = ""
    trainer._first_found.cache_clear()
    monkeypatch.setattr(trainer, "candidates", lambda: [])
    with pytest.raises(RuntimeError, match="choose it in the add-on's preferences"):
        bpy.ops.cloak.train_start()


def test_python_is_found_and_remembered(ready, stub, monkeypatch):
    from cloak import trainer

    preferences().python = ""
    trainer._first_found.cache_clear()
    monkeypatch.setenv("CLOAK_PYTHON", str(stub))
    bpy.ops.cloak.find_python()
    assert preferences().python == str(stub)
    bpy.ops.cloak.test_python()
    job = run_job()
    assert preferences().answer.startswith("Cloak 0.stub, torch 0.stub, Python 3") and "CPU" in job.message
    preferences().python = str(stub)
    bpy.ops.cloak.copy_install_line()
    assert "pip install" in trainer.INSTALL_LINE


def test_test_says_what_is_wrong(ready, stub, monkeypatch, tmp_path):
    from cloak import trainer

    bad = tmp_path / "half"
    bad.write_text(
        '#!/bin/sh\ncase "$2" in *find_spec*) exit 0;; esac\necho "ImportError: no libtorch.so" >&2; exit 1\n'
    )
    bad.chmod(0o755)
    preferences().python = str(bad)
    bpy.ops.cloak.test_python()
    run_job()
    assert "no working cloak_core: ImportError: no libtorch.so" in preferences().answer
    with pytest.raises(InputError, match="no libtorch"):
        trainer.about(str(bad))


def test_blenders_own_python_settings_do_not_reach_the_trainer(monkeypatch):
    from cloak.trainer import clean_environment

    monkeypatch.setenv("PYTHONPATH", "/blender/scripts")
    monkeypatch.setenv("PYTHONHOME", "/blender")
    assert not {"PYTHONPATH", "PYTHONHOME"} & set(clean_environment())


# --- folders ---------------------------------------------------------------------------------------------------------


def test_read_only_output(ready):
    bpy.context.scene.cloak.output = "/proc/cloak"
    with pytest.raises(RuntimeError, match="cannot be written"):
        bpy.ops.cloak.train_start()
    assert training_job.current is None and not ready.cloak.run


def test_output_beside_an_unsaved_file_is_refused(ready):
    bpy.context.scene.cloak.output = "//runs"
    with pytest.raises(RuntimeError, match="save that first"):
        bpy.ops.cloak.train_start()


def test_output_is_the_extensions_own_folder_when_none_is_chosen(ready):
    bpy.context.scene.cloak.output = ""
    bpy.ops.cloak.train_start()
    assert run_job().state == "done"
    own = Path(bpy.utils.extension_path_user(MODULE, path="", create=False))
    assert own in Path(ready.cloak.run).parents


def test_resume_without_its_input_is_refused(ready):
    with pytest.raises(RuntimeError, match="no training to resume"):
        bpy.ops.cloak.train_resume()
    ready.cloak.run = "/nowhere/run"
    with pytest.raises(RuntimeError, match="cannot be resumed"):
        bpy.ops.cloak.train_resume()


# --- bad settings ----------------------------------------------------------------------------------------------------


def test_settings_that_cannot_work_are_named(ready, tmp_path):
    settings = bpy.context.scene.cloak
    for change, words in (
        ({"angle_first": 20, "angle_last": 10}, "Angles 20 to 10"),
        ({"backgrounds": str(tmp_path / "none")}, "Backgrounds folder .* does not exist"),
        ({"detector": "DARKNET"}, "Detector > Config is empty: choose a file"),
        ({"detector": "DARKNET", "darknet_cfg": "/x.cfg"}, "/x.cfg does not exist"),
        ({"config": "/x.toml"}, "Settings File: /x.toml does not exist"),
        ({"detector": "PYTHON", "python_file": __file__, "python_function": " "}, "Function is empty"),
        ({"detector": "TORCHVISION", "torchvision_name": ""}, "Model is empty"),
    ):
        before = {key: getattr(settings, key) for key in change}
        for key, value in change.items():
            setattr(settings, key, value)
        with pytest.raises(RuntimeError, match=words):
            bpy.ops.cloak.train_start()
            assert re.search(words, steps.train_reason(bpy.context))
        for key, value in before.items():
            setattr(settings, key, value)


def test_detector_specs(tmp_path):
    from cloak.properties import detector_spec

    settings = bpy.context.scene.cloak
    for name in ("a.cfg", "a.weights", "d.py"):
        (tmp_path / name).touch()
    assert detector_spec(settings) == "builtin"
    settings.detector = "DARKNET"
    settings.darknet_cfg, settings.darknet_weights = str(tmp_path / "a.cfg"), str(tmp_path / "a.weights")
    assert detector_spec(settings) == f"darknet:{tmp_path / 'a.cfg'}:{tmp_path / 'a.weights'}"
    settings.detector = "PYTHON"
    settings.python_file, settings.python_function = str(tmp_path / "d.py"), "load"
    assert detector_spec(settings) == f"python:{tmp_path / 'd.py'}:load"
    settings.detector = "TORCHVISION"
    assert detector_spec(settings) == "torchvision:fasterrcnn_mobilenet_v3_large_fpn"


# --- Blender closes --------------------------------------------------------------------------------------------------


def test_disabling_the_add_on_ends_the_training_in_order(ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.ops.cloak.train_start()
    job, run = training_job.current, Path(ready.cloak.run)
    wait_for(lambda: job.progress.step >= 2)
    bpy.ops.preferences.addon_disable(module=MODULE)
    try:
        assert (run / "cancel").exists()
        job._process.wait(timeout=10)
        wait_until = time.monotonic() + 5
        while any(t.name == "cloak events" for t in threading.enumerate()) and time.monotonic() < wait_until:
            time.sleep(0.01)
        assert not any(t.name == "cloak events" for t in threading.enumerate())
    finally:
        bpy.ops.preferences.addon_enable(module=MODULE)


def test_closing_blender_mid_run_and_resuming_from_the_saved_file(ready, monkeypatch, tmp_path):
    """Another Blender starts the training, saves, and ends by itself; then by a kill. Both times this one resumes."""
    monkeypatch.setenv("CLOAK_STUB", "slow")
    for how in ("bpy.ops.wm.quit_blender()", "os.kill(os.getpid(), 9)"):
        file = tmp_path / f"{len(how)}.blend"
        bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True)
        script = f"""
import bpy, os, sys, time
bpy.ops.preferences.addon_enable(module={MODULE!r})
bpy.ops.wm.open_mainfile(filepath={str(file)!r})
bpy.context.preferences.addons[{MODULE!r}].preferences.python = {preferences().python!r}
from {MODULE} import training_job
bpy.ops.cloak.train_start()
while training_job.current.progress.step < 2:
    training_job.tick(); time.sleep(0.01)
bpy.ops.wm.save_mainfile()
print("trainer is process", training_job.current._process.pid, flush=True)
import addon_utils
if "quit" in {how!r}:
    addon_utils.disable_all()  # what Blender does when it closes
    os._exit(0)
{how if "kill" in how else "pass"}
"""
        (tmp_path / "other.py").write_text(script)
        command = blender_command(tmp_path / "other.py")
        other = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        said = re.search(r"trainer is process (\d+)", other.stdout)
        assert said, other.stdout + other.stderr
        pid = int(said[1])
        if "kill" in how:  # nobody was left to end the trainer: it goes on by itself, and loses nothing
            os.kill(pid, signal.SIGTERM)
        until = time.monotonic() + 10
        while _alive(pid) and time.monotonic() < until:
            time.sleep(0.02)
        assert not _alive(pid)
        bpy.ops.wm.open_mainfile(filepath=str(file))
        obj = bpy.data.objects["Body"]
        bpy.context.view_layer.objects.active = obj
        assert int(Path(obj.cloak.run, "step.txt").read_text()) < 20
        assert steps.resume_reason(bpy.context) == ""
        bpy.ops.cloak.train_resume()
        assert run_job().state == "done" and red_faces(obj) == IDS


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().split(")")[1].split()[0] != "Z"


# --- jobs ------------------------------------------------------------------------------------------------------------


def test_a_job_runs_its_commands_in_order_and_stops_at_the_first_that_fails(tmp_path):
    import sys

    say = lambda text: [sys.executable, "-c", f"print({text!r})"]
    ended = []
    job = Job("Two", [say("{}"), say('{"a": 1}')], tmp_path, "two", ended.append).wait()
    assert job.json_outputs() == [{}, {"a": 1}] and ended == [job] and job.fraction == 1
    job = Job("Bad", [[sys.executable, "-c", "import sys; sys.exit('boom')"], say("no")], tmp_path, "bad").wait()
    assert (job.state, job.outputs) == ("failed", [""]) and "boom" in job.message
    with pytest.raises(InputError, match="cannot be started"):
        Job("None", [["/nowhere/python"]], tmp_path, "none")
    job = Job("Long", [[sys.executable, "-c", "import time; time.sleep(60)"]], tmp_path, "long")
    job.cancel()
    assert job.wait(10).state == "stopped"


def test_run_folders_never_collide(tmp_path):
    first = runs.new_run(tmp_path, "a:b", "c*?")
    assert first.name == "a_b c_"
    runs.input_folder(first).mkdir()
    assert runs.new_run(tmp_path, "a:b", "c*?").name == "a_b c_ 2"
    assert runs.new_run(tmp_path, "..", "..").name == "run" or ".." not in runs.new_run(tmp_path, "..", "..").parts


def test_a_training_job_without_events_still_ends(tmp_path, stub):
    run = tmp_path / "never"
    job = TrainingJob([str(stub), "-c", "pass"], run, tmp_path)
    assert job.wait(10).state == "done" and job.progress == Progress()
