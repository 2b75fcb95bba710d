# SPDX-License-Identifier: GPL-3.0-or-later
"""The active logo, tinted in the viewport, and its figures for the panel; both kept until the mesh changes.

Drawing never waits for them: what takes longer than a blink is computed when the user has rested for a moment.
"""

from __future__ import annotations

import contextlib
import functools
import operator
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..blender import colors, faces
from ..blender import mesh_arrays as arrays
from ..blender.faces import LogoStats
from ..body.garments import logo_mask, worn_by
from ..session import session
from . import front

TINT = (1.0, 0.25, 0.6, 0.45)
OUTLINE = (1.0, 1.0, 1.0, 1.0)
OUTLINE_PIXELS = 2.0
LIFT = 0.0008
"""The tint floats this share of the body's size above the surface, so that the two do not flicker."""
BLINK = 0.03
"""Seconds that drawing may wait for a figure."""
REST = 0.2
"""Seconds without a change after which what takes longer is computed."""

_handle: object | None = None
_batch: tuple[object, object | None] = (None, None)


@dataclass(frozen=True)
class _Key:
    """What a kept value was computed from."""

    object: int
    logo: str
    changes: int
    mode: str
    scale: tuple[float, ...]
    """The object's transform without its place."""
    worn: tuple[str, ...]


def _key(obj: bpy.types.Object) -> _Key | None:
    names = faces.logo_names(obj.data)
    if not names:
        return None
    logo = obj.cloak.logo if obj.cloak.logo in names else names[0]
    scale = tuple(value for row in obj.matrix_world.to_3x3() for value in row)
    return _Key(obj.session_uid, logo, session.mesh_changes, obj.mode, scale, tuple(o.name for o in worn_by(obj)))


class _Kept:
    """A value of the active logo, `compute(obj, mask)`, computed again when its key has changed."""

    def __init__(self, compute: Callable[[bpy.types.Object, np.ndarray], object]) -> None:
        self._compute = compute
        self.clear()

    def clear(self) -> None:
        self.key: _Key | None = None
        self.wanted: _Key | None = None
        self.value: object = None
        self._seconds = 0.0

    def get(self, obj: bpy.types.Object, key: _Key) -> object:
        """The value; while a new one is on its way, the last one of the same logo, or None."""
        self.wanted = key
        if self.key != key:
            if bpy.app.background or (not self.slow and obj.mode != "EDIT"):
                self.update(obj)
            elif not bpy.app.timers.is_registered(_catch_up):
                bpy.app.timers.register(_catch_up, first_interval=REST if self.slow else 0)
        same = self.key is not None and (self.key.object, self.key.logo) == (key.object, key.logo)
        return self.value if same else None

    @property
    def slow(self) -> bool:
        return self._seconds >= BLINK

    def update(self, obj: bpy.types.Object) -> None:
        start = time.perf_counter()
        with arrays.current_mesh(obj):
            self.value = self._compute(obj, faces.read_faces(obj, self.wanted.logo))
        self.key, self._seconds = self.wanted, time.perf_counter() - start


def active_stats(obj: bpy.types.Object) -> LogoStats | None:
    """Figures of the active logo; None where the mesh has none, or while they are first computed."""
    key = _key(obj)
    return _stats.get(obj, key) if key is not None else None


def _catch_up() -> float | None:
    """Timer: compute what was asked for last, once the user rests."""
    obj, late = bpy.context.object, [kept for kept in (_stats, _tint, _outline) if kept.wanted != kept.key]
    if not late or obj is None or obj.type != "MESH" or not obj.data:
        return None
    if time.monotonic() - session.mesh_changed_at < REST and any(kept.slow for kept in late):
        return REST
    key = _key(obj)
    if key is None:
        return None
    with arrays.current_mesh(obj):  # one copy for all
        for kept in late:
            kept.wanted = key
            kept.update(obj)
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
    return None


def _worn_with(obj: bpy.types.Object) -> list[tuple[bpy.types.Object, np.ndarray, str]]:
    """What the camera sees beside the body, and where the active logo goes on there."""
    key = _key(obj)
    return [(o, logo_mask(o, key.logo), key.logo) for o in worn_by(obj)] if key is not None else []


def worn_stats(obj: bpy.types.Object, mask: np.ndarray) -> LogoStats:
    """Figures of the logo on the body and on what it wears; from the front, what a camera there sees of it."""
    parts = [(obj, mask), *((o, on_it) for o, on_it, _ in _worn_with(obj))]
    return replace(functools.reduce(operator.add, (faces.logo_stats(*part) for part in parts)), **front.seen(parts))


def worn_tint(obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
    """`tint_triangles` of the body and of its clothing, in the body's space."""
    back, found = np.array(obj.matrix_world.inverted_safe()), [tint_triangles(obj, mask)]
    for worn, on_it, logo in _worn_with(obj):
        if on_it.any():
            found.append(arrays.to_world(tint_triangles(worn, on_it, logo), back @ np.array(worn.matrix_world)))
    return np.concatenate(found).astype(np.float32)


def tint_triangles(obj: bpy.types.Object, mask: np.ndarray, logo: str = "") -> np.ndarray:
    """[3 n, 3] float32: corners of the logo's triangles in the object's space, lifted off the surface."""
    if obj.mode == "EDIT":
        corners, normals = _edit_triangles(obj, mask)
    else:
        corners, normals = _corners(*_shown_mesh(obj, mask, logo))
    return (corners + LIFT * _size(obj) * normals).astype(np.float32)


def outline_edges(obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
    """[2 n, 3] float32: ends of the edges around the logo in the object's space, lifted off the surface."""
    mesh, mask = _shown_mesh(obj, mask)
    edges = arrays.corner_edges(mesh)[np.repeat(mask, arrays.corner_counts(mesh))]
    around = np.flatnonzero(np.bincount(edges, minlength=len(mesh.edges)) == 1)
    ends = arrays.read(mesh.edges, "vertices", 2, np.int32)[around].ravel()
    corners, normals = arrays.read(mesh.vertices, "co", 3)[ends], arrays.read(mesh.vertex_normals, "vector", 3)[ends]
    return (corners + 2 * LIFT * _size(obj) * normals).astype(np.float32)


def _size(obj: bpy.types.Object) -> float:
    """The body's largest extent in its own space."""
    return max(obj.dimensions) / max(max(abs(s) for s in obj.matrix_world.to_scale()), 1e-9)


def _edit_triangles(obj: bpy.types.Object, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    with arrays.current_mesh(obj) as mesh:
        return _corners(mesh, mask & ~arrays.hidden_faces(mesh))


def _shown_mesh(obj: bpy.types.Object, mask: np.ndarray, logo: str = "") -> tuple[bpy.types.Mesh, np.ndarray]:
    """The mesh that viewports show, and the faces of the logo (the active one, unless named) on it."""
    mesh, key = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data, _key(obj)
    name = logo or (key.logo if key else "")
    return (mesh, mask) if len(mesh.polygons) == len(mask) else _carried_mask(obj, mesh, mask, name)


def _carried_mask(
    obj: bpy.types.Object, evaluated: bpy.types.Mesh, mask: np.ndarray, logo: str
) -> tuple[bpy.types.Mesh, np.ndarray]:
    """The logo where modifiers make other faces: as its attribute arrives there, else on the rest shape."""
    attribute = evaluated.attributes.get(logo)
    if attribute is None or attribute.domain != "FACE":
        return obj.data, mask
    return evaluated, arrays.read(attribute.data, "value", dtype=bool)


def _corners(mesh: bpy.types.Mesh, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places and normals, [3 n, 3] each, of the corners of a mask's triangles."""
    # Normals of the vertices: with the faces' own, edges would gape.
    chosen = arrays.face_triangles(mesh, mask)[0].ravel()
    return arrays.vertex_points(mesh)[chosen], arrays.read(mesh.vertex_normals, "vector", 3)[chosen]


_stats, _tint, _outline = _Kept(worn_stats), _Kept(worn_tint), _Kept(outline_edges)


def _draw() -> None:
    """Viewport callback."""
    obj = bpy.context.object
    if obj is None or obj.type != "MESH" or not bpy.context.scene.cloak.tint or not obj.visible_get():
        return
    if not bpy.context.space_data.overlay.show_overlays or not obj.data.polygons:
        return
    key = _key(obj)
    if key is None:
        return
    if _sees_heat(obj):
        _draw_kept(obj, _outline.get(obj, key), "LINES", OUTLINE)
    elif not _wears_cloak(obj):
        _draw_kept(obj, _tint.get(obj, key), "TRIS", TINT)


def _draw_kept(obj: bpy.types.Object, corners: np.ndarray | None, kind: str, color: tuple[float, ...]) -> None:
    """Draw triangles, or lines, in the object's space."""
    global _batch
    import gpu
    from gpu_extras.batch import batch_for_shader

    lines = kind == "LINES"
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR" if lines else "UNIFORM_COLOR")
    if _batch[0] is not corners:
        some = corners is not None and len(corners)
        _batch = (corners, batch_for_shader(shader, kind, {"pos": corners}) if some else None)
    if _batch[1] is None:
        return
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.blend_set("ALPHA")
    with gpu.matrix.push_pop():
        gpu.matrix.multiply_matrix(obj.matrix_world)
        if lines:
            region = bpy.context.region
            shader.uniform_float("viewportSize", (region.width, region.height))
            shader.uniform_float("lineWidth", OUTLINE_PIXELS * bpy.context.preferences.system.ui_scale)
        shader.uniform_float("color", color)
        _batch[1].draw(shader)
    gpu.state.blend_set("NONE")
    gpu.state.depth_test_set("NONE")


def _sees_heat(obj: bpy.types.Object) -> bool:
    """Whether this viewport shows the heat map, which a tint would hide."""
    shading = bpy.context.space_data.shading
    return shading.type == "SOLID" and shading.color_type == "VERTEX" and colors.shows_heat(obj)


def _wears_cloak(obj: bpy.types.Object) -> bool:
    """While trained colours or a heat map are shown, a tint over them would falsify them."""
    shading = bpy.context.space_data.shading
    if shading.type == "SOLID":
        return shading.color_type == "VERTEX" and colors.shown_attribute(obj) in (colors.CLOAK, colors.HEATMAP)
    return colors.is_dressed(obj)


@persistent
def _on_change(scene: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    """Selecting, and moving an object about, change no logo."""
    meshes = (bpy.types.Object, bpy.types.Mesh)
    if any(update.is_updated_geometry and isinstance(update.id, meshes) for update in graph.updates):
        _note_change()


@persistent
def _on_frame(scene: bpy.types.Scene, graph: bpy.types.Depsgraph | None = None) -> None:
    _note_change()


def _note_change() -> None:
    session.mesh_changes, session.mesh_changed_at = session.mesh_changes + 1, time.monotonic()


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
    global _handle, _batch
    if _handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).remove(handler)
    with contextlib.suppress(ValueError):
        bpy.app.timers.unregister(_catch_up)
    _handle, _batch = None, (None, None)
    for kept in (_stats, _tint, _outline):
        kept.clear()
