"""The detector's eye: where it looks from, what it asks and when, what it draws, when it closes."""

import json
import math
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from cloak.files.errors import InputError
from cloak.result import eye, viewpoints
from cloak.session import session
from cloak.trainer import jobs
from conftest import folder_of, run_job
from made import add_camera
from mathutils import Matrix, Vector

# --- where one looks from --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("azimuth", "elevation", "distance"), [(0, 0, 2), (35, 20, 3), (-130, -15, 1.5), (20, 90, 4)])
def test_a_viewpoint_stands_where_the_camera_does(azimuth, elevation, distance):
    a, e = math.radians(azimuth), math.radians(elevation)
    away = Vector((math.cos(e) * math.sin(a), -math.cos(e) * math.cos(a), math.sin(e)))
    turn = Matrix.Rotation(a, 4, "Z") @ Matrix.Rotation(math.pi / 2 - e, 4, "X")
    middle = Vector((3, 1, 0.9))
    found = viewpoints.viewpoint(Matrix.Translation(middle + distance * away) @ turn, 50.0, 400, 300, middle)
    assert math.isclose(found.azimuth, azimuth, abs_tol=1e-3) and math.isclose(found.elevation, elevation, abs_tol=1e-3)
    assert math.isclose(found.distance, distance, rel_tol=1e-5)
    assert np.allclose(found.pivot, (3, 0.9, -1), atol=1e-5)  # y up, facing +z
    assert found.is_like(found.sized(100)) and not found.is_like(viewpoints.replace(found, azimuth=azimuth + 1.0))


def seen_at(view: viewpoints.Viewpoint, point: tuple) -> tuple[float, float]:
    """Where the trainer sees a point of Blender's, in shares of the picture from its lower left."""
    a, e = math.radians(view.azimuth), math.radians(view.elevation)
    right = np.array([math.cos(a), 0.0, -math.sin(a)])
    up = np.array([-math.sin(e) * math.sin(a), math.cos(e), -math.sin(e) * math.cos(a)])
    away = np.array([point[0], point[2], -point[1]]) - view.place()
    focal = 0.5 / math.tan(math.radians(view.field_of_view) / 2) / -np.dot(away, np.cross(right, up))
    return 0.5 + focal * np.dot(away, right) * view.height / view.width, 0.5 + focal * np.dot(away, up)


def test_the_scenes_camera(dressed):
    scene = bpy.context.scene
    with pytest.raises(InputError, match="no camera"):
        viewpoints.of_camera(scene, dressed)
    camera = add_camera((2, 0, 0.9))
    scene.render.resolution_x, scene.render.resolution_y = 1920, 1080
    found = viewpoints.of_camera(scene, dressed)
    assert math.isclose(found.azimuth, 90, abs_tol=1e-3) and math.isclose(found.distance, 2, rel_tol=1e-5)
    for point in ((0.3, 0.2, 1.5), (-0.4, -0.5, 0.1)):
        wanted = world_to_camera_view(scene, camera, Vector(point))
        assert np.allclose(seen_at(found, point), wanted[:2], atol=1e-5)
    assert (found.sized(640).width, found.sized(640).height) == (640, 360)
    camera.data.shift_x = 0.1
    with pytest.raises(InputError, match="lens shift"):
        viewpoints.of_camera(scene, dressed)
    camera.data.type = "ORTHO"
    with pytest.raises(InputError, match="no perspective"):
        viewpoints.of_camera(scene, dressed)


# --- the detector's eye ----------------------------------------------------------------------------------------------


def watch(until, seconds: float = 20) -> None:
    """Let the eye look, as Blender's timer would."""
    end = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < end and session.eye is not None, session.job_of(eye.LABEL).message
        jobs.tick()
        time.sleep(0.02)


def asked() -> dict:
    return json.loads(Path(bpy.app.tempdir, "cloak eye", "asked.json").read_text())


@pytest.fixture
def open_eye(dressed):
    bpy.context.scene.cloak.judging.eye_from = "CAMERA"
    add_camera((0, -3, 0.9))
    bpy.ops.cloak.eye()
    watch(lambda: session.eye.seen is not None)
    return session.eye


def test_the_eye_sees_own_clothing_and_the_cloak(dressed, open_eye):
    clothing, cloak = open_eye.seen.sights
    assert (clothing.spec, clothing.kind, clothing.describe()) == ("builtin", "clothing", "found, 0.90")
    assert (cloak.kind, cloak.describe()) == ("cloak", "hidden, 0.20")
    told = asked()
    assert math.isclose(told["azimuth"], 0, abs_tol=1e-3) and math.isclose(told["distance"], 3, rel_tol=1e-4)
    assert told["colors"] == str(folder_of(dressed) / "colors.npy") and max(told["width"], told["height"]) == 640
    words = [line for line, _ in eye.lines(open_eye, fits=True)]
    assert words[1:] == ["builtin reports from 0.5", "    Own clothing: found, 0.90", "    Cloak: hidden, 0.20"]
    box = eye.box_in((100, 50, 300, 150), clothing.boxes[0], open_eye.seen)
    assert np.allclose(box, (100, 50, 200, 150))
    assert session.first_in("") is None  # a training may run beside it


def test_the_eye_looks_again_when_view_body_or_colours_change(dressed, open_eye):
    before = asked()
    bpy.context.scene.camera.location.x = 1.5
    bpy.context.scene.camera.rotation_euler = (
        (Vector((1.5, -3, 0.9)) - Vector((0, 0, 0.9))).to_track_quat("Z", "Y").to_euler()
    )
    bpy.context.view_layer.update()
    watch(lambda: asked()["azimuth"] > 20)
    dressed.location.z = 0.25
    bpy.context.view_layer.update()
    watch(lambda: math.isclose(asked()["lowest"], 0.25, abs_tol=1e-4))
    (folder_of(dressed) / "colors.npy").unlink()  # as before training
    watch(lambda: "colors" not in asked())
    assert "colors" in before
    watch(lambda: [sight.kind for sight in open_eye.seen.sights] == ["clothing"])
    bpy.context.scene.cloak.judging.eye_background = 7
    watch(lambda: asked()["background"] == 7)
    calm = Path(bpy.app.tempdir, "cloak eye", "asked.json").stat().st_mtime_ns
    for _ in range(20):
        jobs.tick()
        time.sleep(0.01)
    assert Path(bpy.app.tempdir, "cloak eye", "asked.json").stat().st_mtime_ns == calm  # nothing new, nothing asked


def test_the_eye_ends_with_its_body_its_process_and_its_button(dressed, open_eye):
    bpy.ops.cloak.eye()
    assert run_job().message == "Detector's Eye stopped" and session.eye is None
    bpy.ops.cloak.eye()
    session.eye._process.kill()
    assert "was killed (signal 9)" in run_job().message and session.eye is None
    bpy.ops.cloak.eye()
    assert session.job_of(eye.LABEL).message == ""
    bpy.data.objects.remove(dressed)
    assert "is gone" in run_job().message and session.eye is None


def test_the_eye_asks_other_detectors_once_they_are_in_the_list(dressed, open_eye):
    bpy.context.scene.cloak.detectors.add().spec = "torchvision:x"
    watch(lambda: open_eye.seen is not None and open_eye.seen.sights[0].spec == "torchvision:x")
