"""The list of runs: found on the disk, so that neither undo nor a killed Blender loses one."""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from cloak.blender import colors
from cloak.files.errors import InputError
from cloak.result.evaluations import result_reason
from cloak.session import session
from cloak.trainer import jobs
from cloak.training import run_list, runs
from cloak.training.operators import run_reason, selected_run
from conftest import LOGO_FACES, MODULE, TRAIN_THERE, elsewhere, folder_of, red_faces, run_job, wait_for
from made import made_run, make_egg


def listed() -> dict[str, str]:
    """State by name, as the panel's list has them."""
    run_list.refresh(bpy.context)
    return {Path(item.path).name: session.runs[item.path].state for item in bpy.context.window_manager.cloak.runs}


def choose(name: str) -> None:
    """Click on a line of the list."""
    run_list.refresh(bpy.context)
    window = bpy.context.window_manager.cloak
    window.run_index = [Path(item.path).name for item in window.runs].index(name)


def cancelled_run(obj: bpy.types.Object, monkeypatch) -> Path:
    """Train a few steps and stop."""
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.ops.cloak.train_start()
    wait_for(lambda: session.job.progress.step >= 2)
    bpy.ops.cloak.train_cancel()
    run_job()
    monkeypatch.setenv("CLOAK_STUB", "")
    return folder_of(obj)


def test_runs_are_listed_with_how_they_ended(ready, monkeypatch):
    bpy.ops.cloak.train_start()
    run_job()
    assert listed() == {"Body Brust_Ärmel": "done"}
    cancelled_run(ready, monkeypatch)
    monkeypatch.setenv("CLOAK_STUB", "die")
    bpy.ops.cloak.train_start()
    run_job()
    monkeypatch.setenv("CLOAK_STUB", "refuse")
    bpy.ops.cloak.train_start()
    run_job()
    expected = {"": "done", " 2": "stopped", " 3": "failed", " 4": "failed"}
    assert listed() == {f"Body Brust_Ärmel{number}": state for number, state in expected.items()}
    states = {path.name: state for path, state in ((Path(p), s) for p, s in session.runs.items())}
    assert states["Body Brust_Ärmel"].progress.step == 20 and states["Body Brust_Ärmel"].progress.success > 0
    assert states["Body Brust_Ärmel"].object == "Body" and states["Body Brust_Ärmel"].detectors == ("builtin",)
    assert "ended without a word after step 5" in states["Body Brust_Ärmel 3"].why
    assert "--detector builtin: no such thing here" in states["Body Brust_Ärmel 4"].why
    choose("Body Brust_Ärmel")
    assert folder_of(ready).name == "Body Brust_Ärmel" and result_reason(bpy.context) == ""


def test_undo_does_not_forget_a_run_nor_leave_the_body_naked(ready, monkeypatch):
    """Ctrl Z during a training takes back what was done before Start, and with it what the training put on the mesh."""
    bpy.context.scene.cloak.live_seconds, bpy.context.scene.cloak.steps = 0.5, 300
    bpy.ops.ed.undo_push(message="before")
    ready.location.x = 1
    bpy.ops.ed.undo_push(message="moved")
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.ops.cloak.train_start()
    run = folder_of(ready)
    wait_for(lambda: colors.is_dressed(bpy.data.objects["Body"]))
    bpy.ops.ed.undo()
    obj = bpy.data.objects["Body"]
    assert obj.location.x == 0 and not colors.is_dressed(obj)
    assert folder_of(obj) == run and result_reason(bpy.context) == ""
    wait_for(lambda: colors.is_dressed(bpy.data.objects["Body"]))
    assert session.job.running
    bpy.ops.ed.redo()
    assert folder_of(bpy.data.objects["Body"]) == run
    bpy.ops.cloak.train_cancel()
    assert run_job().state == "stopped" and red_faces(bpy.data.objects["Body"]) == LOGO_FACES


def test_a_deleted_body_is_said_at_once_and_undo_brings_all_back(ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.context.scene.cloak.live_seconds, bpy.context.scene.cloak.steps = 0.5, 300
    bpy.ops.ed.undo_push(message="body")
    bpy.ops.cloak.train_start()
    run = folder_of(ready)
    wait_for(lambda: session.job.progress.step >= 1)
    bpy.data.objects.remove(ready)
    bpy.ops.ed.undo_push(message="deleted")
    jobs.tick()
    assert session.job.running and "'Body' was deleted: its training goes on" in session.job.notice
    bpy.ops.ed.undo()
    jobs.tick()
    assert session.job.notice == "" and folder_of(bpy.data.objects["Body"]) == run
    bpy.ops.cloak.train_cancel()
    assert run_job().state == "stopped" and red_faces(bpy.data.objects["Body"]) == LOGO_FACES


# --- trainers that this Blender did not start -------------------------------------------------------------------------


@pytest.fixture
def orphan(ready, monkeypatch, tmp_path):
    """A Blender saved, started a training and was killed; the file is open again, the trainer still at work."""
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.context.scene.cloak.steps = 300
    file = tmp_path / "body.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True)
    there = elsewhere(
        tmp_path, f"bpy.ops.wm.open_mainfile(filepath={str(file)!r})", TRAIN_THERE, "os.kill(os.getpid(), 9)"
    )
    said = re.search(r"trainer is process (\d+)", there.stdout)
    assert said, there.stdout + there.stderr
    bpy.ops.wm.open_mainfile(filepath=str(file))
    bpy.context.view_layer.objects.active = bpy.data.objects["Body"]
    yield int(said[1])
    if is_alive(int(said[1])):
        os.kill(int(said[1]), signal.SIGKILL)


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")")[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_an_orphan_is_found_followed_and_stopped(orphan):
    obj = bpy.data.objects["Body"]
    assert not obj.cloak.run  # the file was saved before Start: it knows nothing of the run
    assert listed() == {"Body Brust_Ärmel": "running"}
    choose("Body Brust_Ärmel")
    assert "is being trained" in run_reason(bpy.context, "resumed")
    make_egg(6, name="Active")
    choose("Body Brust_Ärmel")
    bpy.ops.cloak.run_attach()  # at the first click, whatever is active
    assert bpy.context.object == obj
    job = session.job
    wait_for(lambda: job.progress.step >= 2)
    assert job.running and job.progress.steps == 300
    bpy.context.scene.cloak.live_seconds = 0.5
    wait_for(lambda: colors.is_dressed(obj))
    bpy.ops.cloak.run_stop()
    assert run_job().state == "stopped" and "Resume goes on" in job.message
    wait_for(lambda: not is_alive(orphan))
    assert red_faces(obj) == LOGO_FACES
    assert listed() == {"Body Brust_Ärmel": "stopped"} and run_reason(bpy.context, "resumed") == ""


def test_closing_blender_lets_a_found_training_go_on(orphan):
    choose("Body Brust_Ärmel")
    bpy.ops.cloak.run_attach()
    wait_for(lambda: session.job.progress.step >= 2)
    run = folder_of(bpy.data.objects["Body"])
    bpy.ops.preferences.addon_disable(module=MODULE)
    bpy.ops.preferences.addon_enable(module=MODULE)
    time.sleep(0.3)
    assert is_alive(orphan) and not (run / "cancel").exists()


# --- runs of the command line, and what is no run ---------------------------------------------------------------------


def command_line_run(folder: Path, obj: bpy.types.Object) -> Path:
    """A finished run that has no input beside it."""
    red = np.tile(np.float32([1, 0, 0]), (len(LOGO_FACES), 1))
    run = made_run(folder, obj, LOGO_FACES, red, name="from the command line")
    (run / "config.json").write_text(json.dumps({"format": "cloak run", "detectors": [{"spec": "builtin"}]}))
    events = [
        {"type": "start", "step": 0, "time": 0, "steps": 9},
        {"type": "step", "step": 9, "time": 3, "success": 0.8},
    ]
    events.append({"type": "end", "step": 9, "time": 3, "outcome": "done"})
    (run / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    return run


def test_a_run_of_the_command_line_is_listed_loaded_and_reported(ready):
    run = command_line_run(Path(bpy.context.scene.cloak.output), ready)
    assert listed() == {run.name: "done"}
    choose(run.name)
    bpy.ops.cloak.result_load()
    assert red_faces(ready) == LOGO_FACES
    bpy.ops.cloak.open_report()
    job = run_job()
    assert job.state == "done" and (run / "report.html").is_file(), job.message
    assert not runs.input_folder(run).exists()
    assert "is done (9/9): Extend trains on" in run_reason(bpy.context, "resumed")


def test_only_what_cloak_made_is_deleted(ready, tmp_path):
    output = Path(bpy.context.scene.cloak.output)
    for name in ("holiday", "work.input"):
        (output / name).mkdir(parents=True)
        (output / name / "photo.jpg").touch()
    assert listed() == {}
    ready.cloak.run = str(output / "holiday")
    with pytest.raises(RuntimeError, match="not a run that Cloak made, and is left alone"):
        bpy.ops.cloak.run_delete()
    run = command_line_run(output, ready)
    (output / f"{run.name}.input").symlink_to(output / "holiday")
    with pytest.raises(InputError, match="left alone"):
        runs.remove(run)
    assert (run / "logo.npy").exists() and (output / "holiday" / "photo.jpg").exists()


def test_damaged_run_folders_are_listed_and_harm_nobody(ready):
    output = Path(bpy.context.scene.cloak.output)
    run = command_line_run(output, ready)
    for name, text in (("config.json", "{"), ("events.jsonl", '{"type": "step"\n\x00\n[]\n'), ("logo.npy", "")):
        (run / name).write_text(text)
    (run / "evaluation").mkdir()
    (run / "evaluation/summary.json").write_text('{"detectors": {"builtin": {"logo": 3, "grey": {"success": "x"}}}}')
    assert listed() == {run.name: "failed"}
    assert session.runs[str(run)].unseen == {} and session.runs[str(run)].detectors == ()


# --- projects move ----------------------------------------------------------------------------------------------------


def test_a_moved_project_finds_its_runs_and_files(ready, monkeypatch, tmp_path):
    """Paths beside the file are kept relative to it, also in what Resume repeats."""
    project = tmp_path / "project"
    (project / "photos").mkdir(parents=True)
    settings = bpy.context.scene.cloak
    settings.output, settings.backgrounds = "", str(project / "photos")
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "body.blend"))
    assert settings.backgrounds == "//photos"
    run = cancelled_run(ready, monkeypatch)
    assert ready.cloak.run == "//cloak runs/Body Brust_Ärmel" and run.parent.parent == project
    bpy.ops.wm.save_mainfile()
    moved = tmp_path / "elsewhere"
    shutil.move(project, moved)
    bpy.ops.wm.open_mainfile(filepath=str(moved / "body.blend"))
    obj = bpy.context.view_layer.objects.active = bpy.data.objects["Body"]
    assert listed() == {"Body Brust_Ärmel": "stopped"} and folder_of(obj).parent.parent == moved
    assert f"--backgrounds={moved / 'photos'}" in selected_run(bpy.context).options
    bpy.ops.cloak.train_resume()
    assert run_job().state == "done" and red_faces(obj) == LOGO_FACES


def test_the_real_trainer_holds_the_lock_that_the_list_asks_for(tmp_path, real_trainer):
    code = (
        "import sys; from pathlib import Path; from cloak_core.files.writing import lock\n"
        "with lock(Path(sys.argv[1]) / '.lock'): print('held', flush=True); sys.stdin.read()"
    )
    holder = subprocess.Popen(
        [str(real_trainer), "-c", code, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdout.readline() == b"held\n"
    assert run_list.read_state(tmp_path).state == "running"
    holder.communicate(timeout=120)
    assert run_list.read_state(tmp_path).state == "failed"


def test_a_found_training_that_dies_has_no_invented_exit_code(orphan):
    choose("Body Brust_Ärmel")
    bpy.ops.cloak.run_attach()
    wait_for(lambda: session.job.progress.step >= 2)
    os.kill(orphan, signal.SIGKILL)
    job = run_job()
    assert job.state == "failed" and "ended without a word after step" in job.message and "code" not in job.message
