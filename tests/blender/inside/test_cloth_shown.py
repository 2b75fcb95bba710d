"""A cloth in renders, baked images, GLB files and pictures for detectors: as fine as it is printed."""

import os
import subprocess
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from cloak.blender import faces, mesh_arrays
from cloak.body.objects import ASSETS
from cloak.exchange.cloth import corner_uv
from cloak.exchange.scenes import read_scene
from cloak.poses.export import export
from cloak.poses.poses import PoseChoice
from cloak.result import render_check
from cloak.training import runs
from cloths_made import METRES, cloth_run, random_squares, seen_pixels, wall, wanted_at
from conftest import ROOT, run_job


def test_a_render_shows_the_square_that_the_trainer_sees(tmp_path):
    """Squarely, unlit: square by square what is in cloth.png, at the place that the trainer computes."""
    obj, squares, side = wall(), random_squares(), 200
    runs.import_colors(bpy.context, obj, cloth_run(tmp_path, obj, np.arange(9), squares))
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2.0
    camera.location, camera.rotation_euler = (0, -3, 0), (np.pi / 2, 0, 0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    render_check.set_up(scene, side, 1)
    scene.render.filter_size, scene.render.dither_intensity = 0.01, 0
    scene.render.filepath = str(tmp_path / "wall.png")
    bpy.ops.render.render(write_still=True)
    place = (np.arange(side) + 0.5) / side * 2 - 1
    x, z = np.meshgrid(place, place)
    off = np.abs(seen_pixels(tmp_path / "wall.png") - wanted_at(x, z, squares)).max(-1)
    assert (off <= 1.001 / 255).mean() > 0.9995, "but for a pixel that is cut by the side of a square"


CORE = """
import sys
import numpy as np
import torch
from cloak_core.core.cameras import Camera
from cloak_core.core.images import dressed
from cloak_core.core.logo import load_logo
from cloak_core.core.paint import blank
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.source import BodySource
from cloak_core.studies.opening import run_pattern
from pathlib import Path
scene, run, out, distance, side = *sys.argv[1:4], float(sys.argv[4]), int(sys.argv[5])
bodies = load_scene(scene).select_poses([0])
cloth = run_pattern(Path(run), load_logo(bodies, Path(run, "logo.npy")))
camera = Camera(width=side, height=side)
source = BodySource(bodies, RenderSettings(light=Light(ambient=1.0, diffuse=0.0, specular=0.0)), camera)
shown = {"pose": 0, "outfit": 0, "azimuth": 0.0, "elevation": camera.elevation, "distance": distance}
view = source.view(shown, None, cloth)
canvas = dressed([view], cloth, blank(1, side, side).fill_(0.5))
worn = canvas.paint(cloth.colors_in(view, 0))[0].clone()
nobody = canvas.paint(torch.zeros(cloth.count, 3))[0]
np.savez(out, worn=worn.permute(1, 2, 0).numpy(), logo=(nobody == 0).all(0).numpy())
"""
"""The trainer's view of the cloth under even light."""


def test_a_body_in_a_ready_cloth_looks_as_the_trainer_renders_it(tmp_path, monkeypatch):
    """On the sample body, near enough that a square of the cloth is three pixels wide."""
    distance, side = 0.6, 832
    bpy.context.scene.cloak.output = str(tmp_path / "runs")
    bpy.ops.cloak.ready_cloak(cloak="transfer-people")
    obj, set_up = bpy.context.object, render_check.set_up
    run = runs.run_of(obj)

    def sharp(scene: bpy.types.Scene, size: int, samples: int) -> None:
        set_up(scene, size, samples)
        scene.render.filter_size, scene.render.dither_intensity = 0.01, 0

    monkeypatch.setattr(render_check, "set_up", sharp)
    monkeypatch.setattr(render_check, "DISTANCE", distance)
    render_check.render_view(obj, tmp_path / "blender.png", 0.0, side, 8)
    (tmp_path / "core.py").write_text(CORE)
    words = [str(ASSETS / "sample"), str(run), str(tmp_path / "core.npz"), str(distance), str(side)]
    command = [os.environ["CLOAK_TRAINER"], str(tmp_path / "core.py"), *words]
    subprocess.run(command, check=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    core = np.load(tmp_path / "core.npz")
    shown, logo = seen_pixels(tmp_path / "blender.png")[::-1], core["logo"]
    off = np.abs(shown - core["worn"]).max(-1)[logo]
    aside = np.abs(np.roll(shown, 3, 1) - core["worn"]).max(-1)[logo]
    means = np.abs(shown - core["worn"][logo].mean(0)).max(-1)[logo]
    assert logo.mean() > 0.2
    assert np.median(off) < 2 / 255 and off.mean() < 0.15 * min(aside.mean(), means.mean())


@pytest.fixture
def turned(clothed) -> bpy.types.Object:
    """A body in a cloth that was trained on it, turned since."""
    obj, ids, _ = clothed
    run = runs.run_of(obj)
    faces.new_logo(obj, "logo", np.isin(np.arange(len(obj.data.polygons)), ids))
    export(bpy.context, obj, "logo", PoseChoice(), runs.input_folder(run))
    bpy.ops.cloak.result_load()
    obj.rotation_euler.z = 0.7
    bpy.context.view_layer.update()
    return obj


def lies_as_in_training(scene: Path, obj: bpy.types.Object) -> bool:
    """Whether the trainer lays the cloth onto the scene as Blender shows it on the object; the poses are others."""
    bodies, width = read_scene(scene), METRES
    shown = mesh_arrays.read(obj.data.uv_layers["cloak.cloth"].uv, "vector", 2)
    turned = not np.allclose(corner_uv(replace(bodies, laid_out=None), width, width), shown, atol=1e-3)
    return turned and np.allclose(corner_uv(bodies, width, width), shown, atol=1e-5)


def test_frames_and_films_wear_the_cloth_as_it_lay_in_training(stub, turned):
    """Whatever pose the first frame is in."""
    obj = turned
    judging = bpy.context.scene.cloak.judging
    judging.bodies, judging.frame_start, judging.frame_end = "FRAMES", 1, 2
    folder = runs.input_folder(runs.run_of(obj))
    bpy.ops.cloak.evaluate()
    assert run_job().state == "done" and lies_as_in_training(folder / "evaluation scene", obj)
    bpy.ops.cloak.turntable()
    assert run_job().state == "done" and lies_as_in_training(folder / "turntable scene", obj)
