"""Nothing stale: a run is found again by what it is, one run is worn, and what is worn is judged."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from cloak.blender import colors
from cloak.exchange.face_lists import write_colors
from cloak.result.evaluations import judged_reason, result_reason
from cloak.session import session
from cloak.trainer import jobs
from cloak.training import runs
from conftest import LOGO_FACES, folder_of, red_faces, run_job, wait_for
from made import set_mode
from test_runs import choose


@pytest.fixture
def training(ready, monkeypatch, tmp_path) -> Path:
    """A training that takes its time, of a file that was saved before Start; its run folder."""
    monkeypatch.setenv("CLOAK_STUB", "slow")
    settings = bpy.context.scene.cloak
    settings.live_seconds, settings.steps, settings.output = 0.5, 300, ""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "body.blend"))
    bpy.ops.cloak.train_start()
    run = session.job.run
    wait_for(lambda: session.job.progress.step >= 1)
    return run


def cancel() -> jobs.Job:
    bpy.ops.cloak.train_cancel()
    return run_job()


def test_revert_open_rename_and_duplicate_find_the_body_again(training, tmp_path):
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "body.blend"))  # File > Revert
    body = bpy.data.objects["Body"]
    assert not body.cloak.run
    wait_for(lambda: colors.is_dressed(body))
    assert session.job.running and session.job.notice == "" and folder_of(body) == training
    body.name = "Mina"
    copy = body.copy()
    copy.data = body.data.copy()
    bpy.context.collection.objects.link(copy)
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "body.blend"))
    assert cancel().state == "stopped" and "no colours" not in session.job.message
    worn = [obj for obj in bpy.data.objects if obj.name.startswith("Mina")]
    assert len(worn) == 2 and red_faces(worn[0]) == LOGO_FACES


def test_an_appended_body_keeps_its_run(training, tmp_path):
    assert cancel().state == "stopped"
    bpy.ops.wm.save_mainfile()
    assert bpy.data.objects["Body"].cloak.run.startswith("//")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    (tmp_path / "elsewhere").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "elsewhere" / "other.blend"))
    with bpy.data.libraries.load(str(tmp_path / "body.blend")) as (_, wanted):
        wanted.objects = ["Body"]
    body = bpy.data.objects["Body"]
    bpy.context.collection.objects.link(body)
    bpy.context.view_layer.objects.active = body
    assert runs.run_of(body) == training and result_reason(bpy.context) == ""
    bpy.ops.cloak.result_load()
    assert red_faces(body) == LOGO_FACES


def finished_run(obj: bpy.types.Object, color: tuple) -> Path:
    bpy.ops.cloak.train_start()
    assert run_job().state == "done"
    run = folder_of(obj)
    write_colors(run / "colors.npy", np.tile(np.float32(color), (len(LOGO_FACES), 1)))
    return run


def color_of(obj: bpy.types.Object) -> list[float]:
    return colors.written_colors(obj)[LOGO_FACES[0]].round(3).tolist()


def test_what_is_chosen_is_worn_and_what_is_worn_is_judged(ready):
    first, second = finished_run(ready, (0, 1, 0)), finished_run(ready, (0, 0, 1))
    choose(first.name)
    assert color_of(ready) == [0, 1, 0] and judged_reason(bpy.context) == ""
    choose(second.name)
    assert color_of(ready) == [0, 0, 1]
    set_mode("EDIT")
    choose(first.name)
    set_mode("OBJECT")
    assert color_of(ready) == [0, 0, 1]
    told = f"The model wears {second.name}, chosen is {first.name}: press Load Colours"
    assert judged_reason(bpy.context) == told
    bpy.ops.cloak.result_load()
    assert judged_reason(bpy.context) == "" and color_of(ready) == [0, 1, 0]


def test_a_training_does_not_paint_over_another_run_that_was_chosen(ready, monkeypatch):
    first = finished_run(ready, (0, 1, 0))
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.context.scene.cloak.live_seconds, bpy.context.scene.cloak.steps = 0.5, 300
    bpy.ops.cloak.train_start()
    wait_for(lambda: red_faces(ready) == LOGO_FACES)
    choose(first.name)
    step = session.job.progress.step
    wait_for(lambda: session.job.progress.step > step + 8)
    assert color_of(ready) == [0, 1, 0] and "wears another run" in session.job.notice
    job = cancel()
    assert color_of(ready) == [0, 1, 0] and "'Body' wears another run" in job.message
