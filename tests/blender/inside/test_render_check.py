"""Render check: a second Blender renders in Cycles from the training cameras; the detector's answers become a line."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from cloak.blender.pictures import read_picture, save_picture
from cloak.result import render_check
from cloak.training import run_list, runs
from conftest import folder_of, run_job
from made import body_of_a_run
from test_export import rig


def dressed(folder: Path) -> bpy.types.Object:
    """An egg that is red all over."""
    obj, _ = body_of_a_run(folder, range(24 * 48))
    bpy.ops.cloak.result_load()
    return obj


def test_the_camera_is_the_trainers(tmp_path):
    """Size and place of the body in the picture follow from distance 2.2, elevation 6, field of view 60."""
    obj = dressed(tmp_path)
    obj.location.x = 5  # the camera looks at the body, wherever it stands
    bpy.context.view_layer.update()
    path = tmp_path / "view.png"
    render_check.render_view(obj, path, azimuth=0, size=104, samples=8)
    picture = read_picture(path)
    covered = picture[..., 3] > 0.5
    rows, columns = np.flatnonzero(covered.any(1)), np.flatnonzero(covered.any(0))
    focal = 52 / np.tan(np.radians(30))
    assert abs(columns.mean() - 51.5) <= 1 and abs(len(columns) - 2 * 0.35 / 2.2 * focal) <= 3
    expected_height = 1.8 * np.cos(np.radians(6)) / 2.2 * focal
    assert abs(len(rows) - expected_height) < 5
    red = picture[covered].mean(0)
    assert red[0] > 0.6 and red[1] < 0.25
    assert not [s for s in bpy.data.scenes if "render" in s.name] and "cloak camera" not in bpy.data.objects


def test_a_rigged_body_is_rendered_in_the_pose_it_stands_in_with_keys_or_without(tmp_path):
    obj = dressed(tmp_path)
    armature = rig(obj)
    bone = armature.pose.bones[0]
    bone.rotation_mode = "XYZ"
    bone.keyframe_insert("rotation_euler", frame=1)
    bone.rotation_euler.z = 1.2 + 2 * np.pi
    angles = tuple(bone.rotation_euler)
    plan = render_check.Plan(obj.name, tmp_path, (0,), samples=1)
    render_check.prepare(plan)
    assert tuple(bone.rotation_euler) == angles and armature.animation_data.action, "the user's stays as it is"
    render_check.run_plan(str(tmp_path / "plan.json"))
    body = np.abs(read_picture(render_check.image_paths(plan)[0])[..., :3] - 0.5).max(2) > 0.1
    assert np.ptp(np.flatnonzero(body.any(0))) > 1.5 * 416 * 0.7 / (2 * 2.2 * np.tan(np.radians(30)))


def test_from_the_operator_to_the_verdict(tmp_path, stub, coarse_renders):
    obj = dressed(tmp_path)
    settings = bpy.context.scene.cloak
    settings.angle_first, settings.angle_last, settings.angle_step = -10, 10, 20
    photographs = tmp_path / "photos"
    photographs.mkdir()
    save_picture(photographs / "blue.png", np.tile(np.float32([0, 0, 1]), (32, 64, 1)))
    settings.backgrounds = str(photographs)
    bpy.ops.cloak.render_check()
    job = run_job(400)
    assert job.state == "done", (job.message, job.log.read_text()[-2000:])
    assert (
        "detected in 0 of 2 renders with the cloak (highest score 0.10, reported from 0.5), in 2 without" in job.message
    )
    folder = runs.side_folder(folder_of(obj)) / "render check"
    with_cloak, without = read_picture(folder / "cloak +10.png"), read_picture(folder / "own +10.png")
    assert with_cloak.shape == (416, 416, 4) and (with_cloak[..., 3] == 1).all()
    assert np.allclose(with_cloak[0, 0], [0, 0, 1, 1], atol=2 / 255)  # the photograph behind
    middle = (slice(150, 260), slice(180, 230))
    assert with_cloak[middle][..., 0].mean() > 0.6 > 0.2 > with_cloak[middle][..., 1].mean()
    assert np.ptp(without[middle].mean((0, 1))[:3]) < 0.05  # grey again
    assert obj.name in bpy.data.objects and bpy.data.filepath == ""  # this Blender's file was not touched
    assert not list(folder_of(obj).parent.rglob("*.blend")), "the copy of the file goes"
    kept = run_list.read_state(folder_of(obj)).checks  # from the disk: undo and closing do not lose it
    assert render_check.holds(kept) and job.message == render_check.describe_all(kept) and not job.is_bad_news
    assert job.message.startswith("The cloak holds. Cycles") and kept[1].picture == folder / "cloak +10.png"


def answer(score: float, point: float = 0.5) -> str:
    """What `cloak detectors check` says of a render."""
    return json.dumps({"max_person": score, "operating_point": point})


@pytest.mark.parametrize(
    ("scores", "holds", "words"),
    [
        ((0.1, 0.2, 0.9, 0.8), True, "The cloak holds. Cycles: person detected in 0 of 2"),
        ((0.7, 0.8, 0.9, 0.8), False, "The cloak failed. Cycles: person detected in 2 of 2"),
        ((0.5, 0.6, 0.9, 0.8), False, "The cloak holds in 1 of 2 renders. Cycles: person detected in 1 of 2"),
        ((0.1, 0.1, 0.2, 0.1), False, "This says nothing: the detector does not find the body without the cloak"),
    ],
)
def test_a_cloak_that_failed_is_said_to_have_failed(tmp_path, scores, holds, words):
    plan = render_check.Plan("Body", tmp_path / "render check", (0, 5))
    plan.folder.mkdir()
    sights = render_check.verdict(plan, ["builtin"], [answer(score) for score in scores])
    assert render_check.holds(sights) == holds and render_check.describe_all(sights).startswith(words)
    assert render_check.last_check(tmp_path) == sights
