# SPDX-License-Identifier: GPL-3.0-or-later
"""Render many bodies, cameras and lights in Cycles, for `cloak evaluate --cycles`, in a process of its own.

    blender -b --factory-startup -P blender_addon/cycles_frames.py -- FOLDER
    python blender_addon/cycles_frames.py -- FOLDER      (a Python with the bpy package)

FOLDER holds `meshes.npz` (vertices and normals [P, V, 3], y up; triangles [T, 3]; colors [K, T, 3], sRGB) and
`job.json` (size, samples, near and far planes, and frames: pose, colors, light, camera, file). Every frame becomes an
RGBA PNG with a transparent surround, in display colours (view transform Standard, no dithering, straight alpha). Frames
that are there already are left alone, so a job that was stopped goes on. Prints one line per frame.
"""

from __future__ import annotations

import json
import math
import os
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

sys.path.append(str(Path(__file__).resolve().parents[1]))  # last: numpy there may be of another Python
from blender_addon.blender.colors import new_material, nodes_of, srgb_to_linear, write_face_colors
from blender_addon.blender.marks import COLORS, PREFIX
from blender_addon.body.objects import blender_axes
from blender_addon.result.render_check import set_up

# --- light -----------------------------------------------------------------------------------------------------------


def matching(scene: bpy.types.Scene, material: bpy.types.Material, color: bpy.types.NodeSocket) -> None:
    """What the trainer's light model has, and nothing else: even light from everywhere (as emission, so that nothing
    shades it) and one distant lamp without shadows; a matte surface; no light that was reflected before.

    The trainer multiplies display colours by 0.5 + 0.3 cos; Cycles multiplies linear ones. White in shade and white
    facing the lamp come out alike, and so, nearly, does what is between.
    """
    shade, lit = srgb_to_linear(0.5), srgb_to_linear(0.8)
    nodes, links = nodes_of(material)
    emission, diffuse, both = (nodes.new(f"Shader{n}") for n in ("NodeEmission", "NodeBsdfDiffuse", "NodeAddShader"))
    emission.inputs["Strength"].default_value = float(shade)
    for shader, socket in ((emission, 0), (diffuse, 1)):
        links.new(color, shader.inputs["Color"])
        links.new(shader.outputs[0], both.inputs[socket])
    output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
    links.new(both.outputs[0], output.inputs["Surface"])  # in place of what a cloth has
    sun = _lamp(scene, "SUN", (0.0, 85.0, 100.0), math.pi * float(lit - shade))
    sun.use_shadow = False
    scene.cycles.max_bounces = 0


def studio(scene: bpy.types.Scene, *_: object) -> None:
    """A softbox from the upper left, a weak one from the right, a dim room: soft shadows, reflected light, sheen."""
    _surround(scene, (0.16, 0.16, 0.17), (0.10, 0.09, 0.08))
    for place, side, watts in (((-1.8, 1.9, 2.4), 1.2, 150.0), ((2.4, 0.6, 1.6), 0.8, 28.0)):
        lamp = _lamp(scene, "AREA", place, watts)
        lamp.shape, lamp.size = "SQUARE", side


def sky(scene: bpy.types.Scene, *_: object) -> None:
    """Outdoors: a blue sky above, brown ground below, and a warm sun from the right that casts shadows."""
    _surround(scene, (0.32, 0.42, 0.58), (0.20, 0.17, 0.13))
    sun = _lamp(scene, "SUN", (1.1, 1.3, 1.0), 1.9)
    sun.color, sun.angle = (1.0, 0.94, 0.84), math.radians(2)


LIGHTS = {"matching": matching, "studio": studio, "sky": sky}


def _lamp(scene: bpy.types.Scene, kind: str, place: tuple[float, float, float], power: float) -> bpy.types.Light:
    """A lamp at a place (y up, metres) that shines at the middle of the body."""
    lamp = bpy.data.lights.new("lamp", kind)
    lamp.energy = power
    holder = bpy.data.objects.new("lamp", lamp)
    where = Vector(blender_axes(np.array(place)).tolist())
    holder.location, holder.rotation_euler = where, where.to_track_quat("Z", "Y").to_euler()
    scene.collection.objects.link(holder)
    return lamp


def _surround(scene: bpy.types.Scene, above: tuple[float, ...], below: tuple[float, ...]) -> None:
    """A world of two colours (linear) that meet softly at the horizon."""
    world = scene.world = bpy.data.worlds.new("world")
    nodes, links = nodes_of(world)
    nodes.clear()
    where, split, ramp, light, out = (
        nodes.new(f"ShaderNode{n}") for n in ("TexCoord", "SeparateXYZ", "MapRange", "Background", "OutputWorld")
    )
    ramp.inputs["From Min"].default_value, ramp.inputs["From Max"].default_value = -0.2, 0.2
    mix = nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    colors = [socket for socket in mix.inputs if socket.type == "RGBA"]
    colors[0].default_value, colors[1].default_value = (*below, 1), (*above, 1)
    links.new(where.outputs["Generated"], split.inputs[0])
    links.new(split.outputs["Z"], ramp.inputs["Value"])
    links.new(ramp.outputs["Result"], mix.inputs["Factor"])
    links.new(next(s for s in mix.outputs if s.type == "RGBA"), light.inputs["Color"])
    links.new(light.outputs[0], out.inputs["Surface"])


# --- scene -----------------------------------------------------------------------------------------------------------


def new_scene(light: str, size: int, samples: int) -> tuple[bpy.types.Scene, bpy.types.Material, bpy.types.Object]:
    """An empty scene under one of `LIGHTS`, its material and its camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    set_up(scene, size, samples)
    scene.render.dither_intensity = 0
    scene.render.use_persistent_data = True
    if "OMP_NUM_THREADS" in os.environ:
        scene.render.threads_mode, scene.render.threads = "FIXED", int(os.environ["OMP_NUM_THREADS"])
    scene.cycles.use_adaptive_sampling = False
    # The trainer's pixels are boxes of one pixel.
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 1.0
    material, source = new_material("body", "ShaderNodeVertexColor")
    source.layer_name = PREFIX + COLORS
    LIGHTS[light](scene, material, source.outputs["Color"])
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    return scene, material, scene.camera


def new_body(scene: bpy.types.Scene, vertices: np.ndarray, normals: np.ndarray, triangles: np.ndarray) -> object:
    """One body: smooth, with the trainer's own vertex normals."""
    mesh = bpy.data.meshes.new("body")
    mesh.from_pydata(blender_axes(vertices).tolist(), [], triangles.tolist())
    if len(mesh.polygons) != len(triangles):
        raise RuntimeError(f"Blender made {len(mesh.polygons)} faces of {len(triangles)} triangles")
    mesh.polygons.foreach_set("use_smooth", np.ones(len(triangles), bool))
    mesh.normals_split_custom_set_from_vertices(blender_axes(normals).tolist())
    obj = bpy.data.objects.new("body", mesh)
    scene.collection.objects.link(obj)
    return obj


def aim(camera: bpy.types.Object, frame: dict, near: float, far: float) -> None:
    """Stand where the frame says: position and the axes right, up, back (y up)."""
    axes = blender_axes(np.array(frame["axes"]))
    matrix = Matrix.Identity(4)
    for column in range(3):
        matrix.col[column][:3] = axes[column]
    matrix.translation = blender_axes(np.array(frame["position"])).tolist()
    camera.matrix_world = matrix
    camera.data.sensor_fit = "VERTICAL"
    camera.data.angle = math.radians(frame["field_of_view"])
    camera.data.clip_start, camera.data.clip_end = near, far


def render_frames(folder: Path) -> None:
    """Every frame of the job that is not there yet, light by light and body by body."""
    job = json.loads((folder / "job.json").read_text("utf-8"))
    arrays = np.load(folder / "meshes.npz", allow_pickle=False)
    frames = [f for f in job["frames"] if not (folder / f["file"]).exists()]
    order = sorted(frames, key=lambda f: (list(LIGHTS).index(f["light"]), f["pose"]))
    light = pose = scene = body = None
    for number, frame in enumerate(order, 1):
        if frame["light"] != light:
            light, pose = frame["light"], None
            scene, material, camera = new_scene(light, job["size"], job["samples"])
        if frame["pose"] != pose:
            if pose is not None:
                bpy.data.objects.remove(body)
            pose = frame["pose"]
            body = new_body(scene, arrays["vertices"][pose], arrays["normals"][pose], arrays["triangles"])
            body.data.materials.append(material)
        write_face_colors(body, COLORS, arrays["colors"][frame["colors"]])
        aim(camera, frame, job["near"], job["far"])
        partial = folder / f"partial-{frame['file']}"
        scene.render.filepath = str(partial)
        bpy.ops.render.render(write_still=True)
        os.replace(partial, folder / frame["file"])
        print(f"frame {number} of {len(order)}: {frame['file']}", flush=True)


if __name__ == "__main__":
    render_frames(Path(sys.argv[-1]))
    sys.stdout.flush()
    os._exit(0)  # the bpy package may wait for ever at a regular exit
