"""A trainer on another machine: here the same one, behind a prefix that runs a line of shell, as ssh does.

Files go through the prefix, or through a folder that both machines see at places of their own.
"""

import bpy
import pytest
from cloak.blender.mesh_arrays import topology
from cloak.session import session
from cloak.trainer.preferences import preferences
from cloak.training import run_states
from conftest import LOGO_FACES, folder_of, red_faces, run_job, wait_for


@pytest.fixture(params=["by the command", "by a shared folder"])
def elsewhere(request, ready, stub, tmp_path):
    """Preferences of somebody whose trainer is on another machine, which starts in another folder."""
    kept, home = preferences(), tmp_path / "other machine"
    home.mkdir()
    ssh = tmp_path / "fake ssh"
    pipes = "exec 0</dev/null" if request.param == "by a shared folder" else ""  # no file comes through the command
    ssh.write_text(f'#!/bin/sh\ncd "{home}"\n{pipes}\nexec sh -c "$2"\n')  # its last word goes to a shell there
    ssh.chmod(0o755)
    if request.param == "by a shared folder":
        (home / "cloak").mkdir()
        (tmp_path / "mount").symlink_to(home / "cloak")
        kept.remote_shared = str(tmp_path / "mount")
    kept.remote, kept.remote_folder, kept.remote_python = f"'{ssh}' box", str(home / "cloak"), str(stub)
    kept.python = ""
    yield home
    kept.remote = kept.remote_shared = ""


def test_a_training_over_there_shows_its_progress_and_colours_here(elsewhere, ready):
    bpy.ops.cloak.train_start()
    job = run_job(200)
    assert job.state == "done", (job.message, job.log.read_text())
    assert job.progress.step == 20 and red_faces(ready) == LOGO_FACES
    run = folder_of(ready)
    assert run_states.read_state(run).state == "done" and not run.is_relative_to(elsewhere)
    over_there = [path for path in elsewhere.rglob("events.jsonl")]
    assert over_there and over_there[0].read_bytes() == (run / "events.jsonl").read_bytes()
    bpy.ops.cloak.evaluate()
    assert run_job(200).state == "done" and run_states.read_state(run).evaluation is not None


def test_cancel_and_resume_over_there(elsewhere, ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.context.scene.cloak.steps, bpy.context.scene.cloak.live_seconds = 150, 0.5
    bpy.ops.cloak.train_start()
    job = session.job
    wait_for(lambda: job.progress.step >= 3 and run_states.is_running(job.run))
    assert job.running and 0 < job.fraction < 1
    bpy.ops.cloak.train_cancel()
    assert run_job(200).state == "stopped", job.message
    reached = job.progress.step
    assert 3 <= reached < 150 and red_faces(ready) == LOGO_FACES
    monkeypatch.setenv("CLOAK_STUB", "")
    bpy.ops.cloak.train_resume()
    assert run_job(200).state == "done" and session.job.progress.step == 150
    assert topology(ready)


def test_a_shared_folder_that_is_not_mounted_is_named(elsewhere, ready):
    preferences().remote_shared = "/no such mount"
    bpy.ops.cloak.train_start()
    assert "/no such mount: the shared folder is not there" in run_job(100).message


def test_a_machine_that_cannot_be_reached_is_named(elsewhere, ready):
    preferences().remote = "false"
    bpy.ops.cloak.train_start()
    job = run_job(100)
    assert job.state == "failed" and "the other machine cannot be reached" in job.message
