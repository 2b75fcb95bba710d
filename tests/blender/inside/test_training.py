"""Step 4 with a stub trainer: the panel's way from Start to colours, and everything that may go wrong on it."""

import json
import math
import re
from pathlib import Path

import bpy
import pytest
from cloak.body import objects as body
from cloak.result.evaluations import result_reason
from cloak.session import session
from cloak.training import run_list
from cloak.training.operators import run_reason, train_reason
from conftest import LOGO_FACES, TRAIN_THERE, elsewhere, folder_of, red_faces, run_job, wait_for
from made import set_mode
from test_runs import is_alive


def test_start_to_colours(ready):
    assert train_reason(bpy.context) == ""
    bpy.ops.cloak.train_start()
    job = run_job()
    assert job.state == "done", job.message
    assert "20/20" in job.message
    assert run_list.selected(bpy.context).state == "done", "the list knows it, whether or not it is drawn again"
    assert red_faces(ready) == LOGO_FACES
    run = Path(ready.cloak.run)
    assert run.parent.name == "Läufe und mehr" and "/" not in run.name and "Brust_Ärmel" in run.name
    assert result_reason(bpy.context) == ""
    set_mode("EDIT")
    bpy.ops.cloak.train_start()  # leaves Edit Mode; a second run gets a folder of its own
    assert ready.mode == "OBJECT" and run_job().state == "done" and Path(ready.cloak.run).name == run.name + " 2"


def test_progress_live_colours_and_cancel_then_resume(ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.context.scene.cloak.live_seconds = 0.5
    bpy.ops.cloak.train_start()
    job = session.job
    bpy.ops.cloak.train_start()
    second = session.jobs[-1]
    assert second.describe() == "Waits for Training" and session.job is job
    bpy.ops.cloak.train_cancel(number=1)
    assert second.state == "stopped" and job.running
    ready.cloak.run = str(job.run)
    wait_for(lambda: job.progress.step >= 3 and "cloak.colors" in ready.data.color_attributes)
    assert red_faces(ready) == LOGO_FACES  # while it is still running
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


def test_trainer_killed(ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "die")
    bpy.ops.cloak.train_start()
    job = run_job()
    assert job.state == "failed"
    assert "killed (signal 9)" in job.message and "Resume goes on from the last checkpoint" in job.message
    assert red_faces(ready) == LOGO_FACES  # what there was is shown
    monkeypatch.setenv("CLOAK_STUB", "")
    bpy.ops.cloak.train_resume()
    assert run_job().state == "done"


def test_broken_event_lines_are_passed_over(ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "broken")
    bpy.ops.cloak.train_start()
    job = run_job()
    assert job.state == "done" and job.progress.describe() == "20/20"
    assert math.isfinite(job.progress.loss) and "nan" not in job.message
    assert red_faces(ready) == LOGO_FACES


def test_object_changed_since_export(ready, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.context.scene.cloak.steps = 300
    bpy.ops.cloak.train_start()
    body.subdivide(ready)
    wait_for(lambda: session.job.progress.step >= 2)
    bpy.ops.cloak.train_cancel()
    job = run_job()
    assert job.state == "stopped" and "no colours imported: 'Body' changed since export" in job.message
    assert "cloak.colors" not in ready.data.color_attributes
    with pytest.raises(RuntimeError, match="changed since export"):
        bpy.ops.cloak.train_resume()


def test_object_deleted_or_in_edit_mode_at_the_end(ready):
    bpy.ops.cloak.train_start()
    set_mode("EDIT")
    job = run_job()
    assert "Leave Edit Mode (Tab) and press Load Colours" in job.message
    set_mode("OBJECT")
    bpy.ops.cloak.result_load()
    assert red_faces(ready) == LOGO_FACES
    bpy.ops.cloak.train_start()
    bpy.data.objects.remove(ready)
    assert "the object is gone" in run_job().message


# --- Blender closes ---------------------------------------------------------------------------------------------------


def test_closing_blender_mid_run_and_resuming_from_the_saved_file(ready, monkeypatch, tmp_path):
    """Another Blender starts the training, saves, and closes: the training ends in order, and this one resumes it."""
    monkeypatch.setenv("CLOAK_STUB", "slow")
    file = tmp_path / "body.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True)
    closing = "import addon_utils; addon_utils.disable_all(); os._exit(0)"  # what Blender does when it closes
    there = elsewhere(
        tmp_path,
        f"bpy.ops.wm.open_mainfile(filepath={str(file)!r})",
        TRAIN_THERE,
        "bpy.ops.wm.save_mainfile()",
        closing,
    )
    said = re.search(r"trainer is process (\d+)", there.stdout)
    assert said, there.stdout + there.stderr
    wait_for(lambda: not is_alive(int(said[1])))
    bpy.ops.wm.open_mainfile(filepath=str(file))
    obj = bpy.data.objects["Body"]
    bpy.context.view_layer.objects.active = obj
    assert int(Path(folder_of(obj), "step.txt").read_text()) < 20
    assert run_reason(bpy.context, "resumed") == ""
    bpy.ops.cloak.train_resume()
    assert run_job().state == "done" and red_faces(obj) == LOGO_FACES
