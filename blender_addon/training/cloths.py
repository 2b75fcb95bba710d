# SPDX-License-Identifier: GPL-3.0-or-later
"""The cloth of a run, laid onto a body as the trainer lays it: in the first pose that was exported."""

from contextlib import suppress
from pathlib import Path

import bpy
import numpy as np

from ..blender.cloth import Cloth, load_cloth
from ..blender.mesh_arrays import mesh_triangles, polygon_loops, vertex_points
from ..body.objects import scene_axes
from ..exchange.bodies import Bodies
from ..exchange.cloth import CLOTH_FILE, cloth_metres, corner_uv
from ..exchange.scenes import read_scene
from ..files.errors import InputError


def is_cloth(run: Path | None) -> bool:
    """Whether what a run trains is a cloth that repeats."""
    return run is not None and (run / CLOTH_FILE).is_file()


def read_cloth(obj: bpy.types.Object, run: Path, scene: Path | None, first: int = 0) -> Cloth | None:
    """The cloth that a run trained, on the object's corners; None where it trained colours of faces.

    scene: what was exported for the run, in which the object's faces are numbered from `first`. Raises `InputError`
    where the cloth is damaged.
    """
    if not is_cloth(run):
        return None
    width, bodies = cloth_metres(run), first_pose(obj, scene)
    if bodies.face_count == len(obj.data.polygons):  # these are the object's own faces alone
        first = 0
    before = int(bodies.loop_total[:first].sum())
    image = load_cloth(run / CLOTH_FILE)
    uv = corner_uv(bodies, width, width * image.size[1] / image.size[0])
    return Cloth(image, uv[before : before + len(obj.data.loops)])


def first_pose(obj: bpy.types.Object, scene: Path | None) -> Bodies:
    """What was exported for a run; where nothing was, or with faces that modifiers made, the object's own mesh."""
    if scene is not None:
        with suppress(InputError):
            bodies = read_scene(scene)
            if bodies.loop_total is not None:
                return bodies
    mesh, turn = obj.data, np.array(obj.matrix_world)[:3, :3]
    counts, loops = polygon_loops(mesh)
    triangles, faces = mesh_triangles(mesh)
    # Where the object stands is left out: bodies from scene packages lie as in the package.
    points = scene_axes(vertex_points(mesh) @ turn.T) * bpy.context.scene.unit_settings.scale_length
    return Bodies(points[None], triangles, faces, loop_total=counts, loop_vertices=loops)
