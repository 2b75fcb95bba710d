# SPDX-License-Identifier: GPL-3.0-or-later
"""From a Blender scene to the trainer's files: a scene package and a face list.

The body's polygons come first and keep their indices, so a logo's face ids mean the same on both sides; clothing
follows them. Polygons are triangulated once, in the first pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from . import colors
from .body import require_body, require_upright, scene_axes, topology
from .exchange.bodies import Bodies
from .exchange.face_lists import write_face_list
from .exchange.scenes import write_scene
from .faces import require_logo
from .files.errors import InputError
from .files.reading import read_json
from .files.writing import new_folder, write_json
from .mesh_arrays import evaluated_mesh, mesh_triangles, polygon_loops, read, to_world
from .poses import PoseChoice, armature_of, list_poses, visit

RECORD = "export.json"
DEFORMS_ONLY = {
    "ARMATURE", "CAST", "CLOTH", "COLLISION", "CORRECTIVE_SMOOTH", "CURVE", "DATA_TRANSFER", "DISPLACE", "HOOK",
    "LAPLACIANDEFORM", "LAPLACIANSMOOTH", "LATTICE", "MESH_CACHE", "MESH_DEFORM", "NORMAL_EDIT", "SHRINKWRAP",
    "SIMPLE_DEFORM", "SMOOTH", "SOFT_BODY", "SURFACE", "SURFACE_DEFORM", "UV_PROJECT", "UV_WARP", "VERTEX_WEIGHT_EDIT",
    "VERTEX_WEIGHT_MIX", "VERTEX_WEIGHT_PROXIMITY", "VOLUME_DISPLACE", "WARP", "WAVE", "WEIGHTED_NORMAL",
}  # fmt: skip
"""Modifier types that never change the number or order of faces."""


@dataclass(frozen=True)
class Part:
    """One evaluated object in one pose, in scene axes and metres."""

    vertices: np.ndarray
    loop_total: np.ndarray
    loop_vertices: np.ndarray
    triangles: np.ndarray | None = None
    triangle_face: np.ndarray | None = None


def clothing_of(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Visible meshes worn by the body: its children, and what shares its armature."""
    armature = armature_of(obj)
    candidates = list(obj.children_recursive)
    if armature is not None:
        candidates += [o for o in bpy.context.view_layer.objects if o.type == "MESH" and armature_of(o) == armature]
    worn = {o for o in candidates if o.type == "MESH" and o != obj and o.visible_get() and len(o.data.polygons)}
    return sorted(worn, key=lambda o: o.name)


def export_bodies(
    context: bpy.types.Context, obj: bpy.types.Object, choice: PoseChoice, with_clothing: bool = False
) -> Bodies:
    """The body (and its clothing) in every chosen pose. Leaves the Blender scene as it was."""
    require_body(obj)
    require_upright(obj)
    objects = [obj, *(clothing_of(obj) if with_clothing else ())]
    for worn in objects[1:]:
        require_upright(worn)
    poses = list_poses(obj, choice)
    frames: list[list[Part]] = []
    with visit(context, obj) as go:
        for pose in poses:
            go(pose)
            graph = context.evaluated_depsgraph_get()
            frames.append([_evaluate(o, graph, with_triangles=not frames) for o in objects])
            _require_same_topology(obj, objects, frames)
    worn = [_outfit(o, part) for o, part in zip(objects[1:], frames[0][1:], strict=True)]
    outfits = np.stack([np.concatenate([outfit, *worn]) for outfit in colors.own_outfits(obj)])
    try:
        return _join(frames, [pose.name for pose in poses], outfits, obj.name)
    except InputError as error:
        raise InputError(f"'{obj.name}': {error}") from None


def _evaluate(obj: bpy.types.Object, graph: bpy.types.Depsgraph, with_triangles: bool) -> Part:
    with evaluated_mesh(obj, graph) as (mesh, matrix):
        world = to_world(read(mesh.vertices, "co", 3), matrix) * graph.scene.unit_settings.scale_length
        triangles = mesh_triangles(mesh) if with_triangles else ()
        return Part(scene_axes(world).astype(np.float32), *polygon_loops(mesh), *triangles)


def _require_same_topology(obj: bpy.types.Object, objects: list[bpy.types.Object], frames: list[list[Part]]) -> None:
    """The body's faces must be the mesh's own, and no object may change its faces between poses."""
    now, first = frames[-1], frames[0]
    loop_total, loop_vertices = polygon_loops(obj.data)
    if not (np.array_equal(now[0].loop_total, loop_total) and np.array_equal(now[0].loop_vertices, loop_vertices)):
        raise InputError(topology_modifiers_reason(obj) or f"The faces of '{obj.name}' change when it is evaluated")
    for worn, a, b in zip(objects[1:], now[1:], first[1:], strict=True):
        if not np.array_equal(a.loop_vertices, b.loop_vertices) or len(a.vertices) != len(b.vertices):
            raise InputError(f"The faces of '{worn.name}' change from pose to pose: turn off its modifiers, or hide it")


def topology_modifiers_reason(obj: bpy.types.Object) -> str:
    """Which visible modifiers may change the body's faces, and what to do; "" when there are none."""
    names = [f"'{m.name}'" for m in obj.modifiers if m.show_viewport and m.type not in DEFORMS_ONLY]
    if not names:
        return ""
    which = "modifier " + names[0] if len(names) == 1 else "modifiers " + ", ".join(names)
    return (
        f"The {which} of '{obj.name}' may change its faces, and a logo belongs to the mesh's own: "
        "apply before making the logo, or turn off in the viewport"
    )


def _outfit(obj: bpy.types.Object, part: Part) -> np.ndarray:
    """[F, 3] sRGB of a piece of clothing."""
    own = colors.own_face_colors(obj)
    if len(own) == len(part.loop_total):
        return own
    # Clothing whose modifiers change its faces: its main material's colour for all of them.
    return np.tile(np.median(own, axis=0), (len(part.loop_total), 1)).astype(np.float32)


def _join(frames: list[list[Part]], names: list[str], outfits: np.ndarray, name: str) -> Bodies:
    first = frames[0]

    def shifted(key: str, counted: str) -> np.ndarray:
        """Indices of all parts, behind what was counted in the parts before."""
        counts = np.cumsum([0] + [len(getattr(part, counted)) for part in first])
        return np.concatenate([getattr(part, key) + count for part, count in zip(first, counts, strict=False)])

    return Bodies(
        vertices=np.stack([np.concatenate([p.vertices for p in parts]) for parts in frames]),
        triangles=shifted("triangles", "vertices"),
        triangle_face=shifted("triangle_face", "loop_total"),
        loop_total=np.concatenate([p.loop_total for p in first]),
        loop_vertices=shifted("loop_vertices", "vertices"),
        face_colors=outfits,
        names=tuple(names),
        name=name,
    )


# --- files -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Export:
    """What one export wrote into `folder`."""

    folder: Path
    object: str
    logo: str
    topology: str
    """Of the body alone: what colours that come back are checked against."""
    poses: int
    faces: int

    @property
    def scene(self) -> Path:
        return self.folder / "scene"

    @property
    def face_list(self) -> Path:
        return self.folder / "logo.npy"


def export(
    context: bpy.types.Context,
    obj: bpy.types.Object,
    logo: str,
    choice: PoseChoice,
    folder: Path,
    with_clothing: bool = False,
) -> Export:
    """Write scene package, face list and record into `folder`, which appears whole or not at all."""
    require_body(obj)
    mask = require_logo(obj, logo)
    if folder.exists():
        raise InputError(f"{folder}: exists already; choose another output folder")
    bodies = export_bodies(context, obj, choice, with_clothing)
    done = Export(folder, obj.name, logo, topology(obj), bodies.pose_count, bodies.face_count)
    with new_folder(folder) as temporary:
        write_scene(temporary / "scene", bodies, creator="cloak add-on")
        write_face_list(temporary / "logo.npy", np.flatnonzero(mask), bodies.topology)
        record = {key: getattr(done, key) for key in ("object", "logo", "topology", "poses", "faces")}
        write_json(temporary / RECORD, {"format": "cloak export", "version": 1, **record})
    return done


def read_export(folder: Path) -> Export:
    """The record of an earlier export."""
    record = read_json(folder / RECORD)
    try:
        words = {key: str(record[key]) for key in ("object", "logo", "topology")}
        return Export(folder, poses=int(record["poses"]), faces=int(record["faces"]), **words)
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{folder / RECORD}: not the record of an export") from None
