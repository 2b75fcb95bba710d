# SPDX-License-Identifier: GPL-3.0-or-later
"""The active logo, tinted in the viewport, and its figures for the panel; both cached until the mesh changes."""

from __future__ import annotations

from dataclasses import dataclass

import bmesh
import bpy
import numpy as np
from bpy.app.handlers import persistent

from . import colors, faces
from .faces import LogoStats
from .mesh_arrays import mesh_triangles, read

TINT = (1.0, 0.25, 0.6, 0.45)
LIFT = 0.0008
"""The tint floats this share of the body's size above the surface, so that the two do not flicker."""

_handle: object | None = None
_changes = 0
_stats: tuple[object, LogoStats | None] = (None, None)
_batch: tuple[object, object | None] = (None, None)


@dataclass(frozen=True)
class _Key:
    """What a cached figure was computed from."""

    object: int
    logo: str
    changes: int
    mode: str


def _key(obj: bpy.types.Object) -> _Key | None:
    names = faces.logo_names(obj.data)
    if not names:
        return None
    logo = obj.cloak.logo if obj.cloak.logo in names else names[0]
    return _Key(obj.session_uid, logo, _changes, obj.mode)


def active_stats(obj: bpy.types.Object) -> LogoStats | None:
    """Figures of the active logo; None where the mesh has none. Recomputed only after the scene changed."""
    global _stats
    key = _key(obj)
    if key is None:
        return None
    if _stats[0] != key and not faces.readable(obj):
        return _stats[1]  # as it was before Edit Mode
    if _stats[0] != key:
        _stats = (key, faces.logo_stats(obj, faces.read_faces(obj, key.logo)))
    return _stats[1]


def tint_triangles(obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
    """[3 n, 3] float32: corners of the logo's triangles in the object's space, lifted off the surface."""
    if obj.mode == "EDIT":
        corners, normals = _edit_triangles(obj, mask)
    else:
        corners, normals = _evaluated_triangles(obj, mask)
    size = max(obj.dimensions) / max(max(abs(s) for s in obj.matrix_world.to_scale()), 1e-9)
    return (corners + LIFT * size * normals).astype(np.float32)


def _edit_triangles(obj: bpy.types.Object, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    bm = bmesh.from_edit_mesh(obj.data)
    wanted = set(np.flatnonzero(mask).tolist())
    bm.faces.index_update()
    loops = [t for t in bm.calc_loop_triangles() if t[0].face.index in wanted and not t[0].face.hide]
    corners = [loop.vert.co[:] for triangle in loops for loop in triangle]
    normals = [loop.vert.normal[:] for triangle in loops for loop in triangle]
    return np.array(corners, np.float32).reshape(-1, 3), np.array(normals, np.float32).reshape(-1, 3)


def _evaluated_triangles(obj: bpy.types.Object, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    if len(mesh.polygons) != len(mask):  # a modifier changes the topology: the rest shape is all there is to show
        mesh = obj.data
    triangles, face = mesh_triangles(mesh)
    chosen = triangles[mask[face]].ravel()
    return read(mesh.vertices, "co", 3)[chosen], read(mesh.vertex_normals, "vector", 3)[chosen]


def _draw() -> None:
    """Viewport callback."""
    global _batch
    import gpu
    from gpu_extras.batch import batch_for_shader

    obj = bpy.context.object
    if obj is None or obj.type != "MESH" or not bpy.context.scene.cloak.tint or not obj.visible_get():
        return
    if not bpy.context.space_data.overlay.show_overlays or not obj.data.polygons:
        return
    key = _key(obj)
    if key is None or _wears_cloak(obj) or not faces.readable(obj):
        return
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    if _batch[0] != key:
        corners = tint_triangles(obj, faces.read_faces(obj, key.logo))
        _batch = (key, batch_for_shader(shader, "TRIS", {"pos": corners}) if len(corners) else None)
    if _batch[1] is None:
        return
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.blend_set("ALPHA")
    with gpu.matrix.push_pop():
        gpu.matrix.multiply_matrix(obj.matrix_world)
        shader.uniform_float("color", TINT)
        _batch[1].draw(shader)
    gpu.state.blend_set("NONE")
    gpu.state.depth_test_set("NONE")


def _wears_cloak(obj: bpy.types.Object) -> bool:
    """While trained colours or a heat map are shown, a tint over them would falsify them."""
    shading = bpy.context.space_data.shading
    shown = obj.data.color_attributes.active_color_name
    if shading.type == "SOLID":
        return shading.color_type == "VERTEX" and shown in (colors.CLOAK, colors.HEATMAP)
    return colors.is_dressed(obj)


@persistent
def _on_change(scene: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    global _changes
    if any(isinstance(update.id, (bpy.types.Object, bpy.types.Mesh)) for update in graph.updates):
        _changes += 1


@persistent
def _on_frame(scene: bpy.types.Scene, graph: bpy.types.Depsgraph | None = None) -> None:
    global _changes
    _changes += 1


HANDLERS = (
    ("depsgraph_update_post", _on_change),
    ("frame_change_post", _on_frame),
    ("load_post", _on_frame),
    ("undo_post", _on_frame),
    ("redo_post", _on_frame),
)


def register() -> None:
    global _handle
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)
    if not bpy.app.background:
        _handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister() -> None:
    global _handle, _stats, _batch
    if _handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).remove(handler)
    _handle, _stats, _batch = None, (None, None), (None, None)
