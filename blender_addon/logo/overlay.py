# SPDX-License-Identifier: GPL-3.0-or-later
"""The active logo, tinted in the viewport, and its figures for the panel; both kept until the mesh changes. And what a
stroke or a stamp will take, while the user still drags.

Drawing never waits for them: what takes longer than a blink is computed when the user has rested for a moment.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..blender import colors, faces
from ..blender import mesh_arrays as arrays
from ..blender.evaluated import Surface
from ..blender.faces import logo_mask
from ..blender.marks import COLORS, HEATMAP
from ..blender.occlusion import depth_buffer
from ..body.garments import worn_by
from ..session import session
from ..ui.drawing import Shape
from ..ui.window import Hooks, between_strokes, redraw

TINT = (1.0, 0.25, 0.6, 0.45)
OUTLINE = (1.0, 1.0, 1.0, 1.0)
LIFT = 0.0008  # the tint floats this share of the body's size above the surface, so that the two do not flicker
BLINK = 0.03  # longest computation, in seconds, that may run while drawing
REST = 0.2  # seconds without a change after which what takes longer is computed
PAINT = "cloak.paint_logo"  # the tool that paints a logo
MOVES = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE"}  # events of a mouse that moves
ADDED, TAKEN = (0.2, 0.9, 1.0, 0.55), (0.05, 0.05, 0.05, 0.6)
PIXELS = 320  # along the longest side of body and clothing: 6 mm of a person
WORTH_TELLING = 0.05  # share of the logo from which on a piece that covers it is named
Part = tuple[bpy.types.Object, np.ndarray]
"""An object, and the mask [F] of the logo's faces on it; the body comes first."""


@dataclass(frozen=True)
class LogoStats:
    """Area and visibility of a logo; areas in square metres, in the current pose."""

    faces: int
    hidden: int
    area_share: float  # of the surface of the body and of what it wears, 0 to 1
    projected_area: float  # of the logo as seen from the front
    whole_projected_area: float  # of the whole outline as seen from the front
    covered: tuple[tuple[str, float], ...] = ()
    """Pieces that do not wear the logo and cover some of it from the front: their names, and the share of it."""


def logo_stats(parts: list[Part]) -> LogoStats:
    """Measure a logo on a body and on its clothing."""
    square = bpy.context.scene.unit_settings.scale_length**2
    shapes, hidden, own, whole = [], 0, 0.0, 1e-12
    for obj, mask in parts:
        with arrays.current_mesh(obj) as mesh:
            hides, seen_mesh = arrays.hidden_faces(mesh), mesh
            if obj.mode != "EDIT":  # as viewports show it where modifiers keep the faces, else as it is without them
                evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
                seen_mesh = evaluated if len(evaluated.polygons) == len(mesh.polygons) else mesh
            points = arrays.to_world(arrays.vertex_points(seen_mesh), np.array(obj.matrix_world))
            corners, face = arrays.mesh_triangles(seen_mesh)
        hidden += int((mask & hides).sum())
        area = arrays.triangle_areas(points, corners)
        own, whole = own + float(area[mask[face]].sum()), whole + float(area.sum())
        seen = ~hides[face] if obj.mode == "EDIT" and hides.any() else slice(None)
        shapes.append((np.stack([points[:, 0], points[:, 2], -points[:, 1]], -1), corners[seen], face[seen]))
    count = sum(int(mask.sum()) for _, mask in parts)
    return LogoStats(count, hidden, own / whole, **_from_the_front(parts, shapes, square))


def _from_the_front(parts: list[Part], shapes: list[tuple[np.ndarray, ...]], square: float) -> dict[str, object]:
    """Measure the projected areas of logo and outline, and which objects cover the logo.

    shapes: of each part vertices [V, 3] as right, up and towards the viewer; triangles [T, 3]; the face of each [T].
    """
    low = np.min([points[:, :2].min(0) for points, _, _ in shapes], axis=0)
    high = np.max([points[:, :2].max(0) for points, _, _ in shapes], axis=0)
    cell = max(float((high - low).max()), 1e-9) / PIXELS
    shape = tuple(np.maximum(1, np.ceil((high - low) / cell)).astype(int).tolist())
    depths, on_logo = [], []
    for (_, mask), (points, corners, face) in zip(parts, shapes, strict=True):
        depth, triangle = depth_buffer((points - [*low, 0]) / [cell, cell, 1], corners, shape)
        depths.append(depth)
        on_logo.append((triangle >= 0) & np.append(mask[face], False)[triangle])
    depths, on_logo = np.array(depths), np.array(on_logo)
    wearing = np.array([index == 0 or mask.any() for index, (_, mask) in enumerate(parts)])
    bare_depth = depths[wearing].max(0)  # without the pieces that do not wear the logo
    bare = _of_nearest(on_logo[wearing], depths[wearing])
    shares = [float((bare & (depth > bare_depth)).sum() / max(1, bare.sum())) for depth in depths]
    covering = zip(parts, shares, wearing, strict=True)
    return {
        "projected_area": float(_of_nearest(on_logo, depths).sum() * cell**2 * square),
        "whole_projected_area": float(np.isfinite(depths.max(0)).sum() * cell**2 * square),
        "covered": tuple((o.name, share) for (o, _), share, wears in covering if not wears and share >= WORTH_TELLING),
    }


def _of_nearest(values: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """[H, W] of values [n, H, W]: in each pixel that of the nearest object."""
    return np.take_along_axis(values, depths.argmax(0)[None], 0)[0]


# --- values that are kept until the mesh changes ----------------------------------------------------------------------

_Key = tuple[str, int, object]
"""What a kept value was computed from: the logo, its object, and whatever else may change the value."""


def _active(obj: bpy.types.Object) -> str:
    """Name of the active logo; "" for none."""
    return faces.active_logo(obj) if faces.logo_names(obj.data) else ""


def _key(obj: bpy.types.Object) -> _Key | None:
    if not _active(obj):
        return None
    turn = tuple(value for row in obj.matrix_world.to_3x3() for value in row)  # a place changes nothing
    others = session.mesh_changes, obj.mode, turn, tuple(o.name for o in worn_by(obj))
    return _active(obj), obj.session_uid, others


class _Kept:
    """A value of the active logo, `compute(obj, mask)`, computed again when its key has changed."""

    def __init__(self, compute: Callable[[bpy.types.Object, np.ndarray], object]) -> None:
        self._compute = compute
        self.clear()

    def clear(self) -> None:
        self.key: _Key | None = None
        self.wanted: _Key | None = None
        self.value, self.seconds = None, 0.0
        self._drawn: tuple[object, Shape | None] = (None, None)

    def get(self, obj: bpy.types.Object, key: _Key) -> object:
        """Return the value; while it is being computed, the last one of the same logo, or None."""
        self.wanted = key
        if self.key != key:
            slow = self.seconds >= BLINK
            if bpy.app.background or (not slow and obj.mode != "EDIT"):
                self.update(obj)
            elif not bpy.app.timers.is_registered(_catch_up):
                bpy.app.timers.register(_catch_up, first_interval=REST if slow else 0)
        return self.value if self.key is not None and self.key[:2] == key[:2] else None

    def draw(self, obj: bpy.types.Object, key: _Key, kind: str, color: tuple[float, ...]) -> None:
        """Draw the value, corners of triangles or ends of lines, in the object's space."""
        corners = self.get(obj, key)
        if self._drawn[0] is not corners:
            self._drawn = corners, Shape(kind, corners, color) if corners is not None and len(corners) else None
        if self._drawn[1] is not None:
            self._drawn[1].draw(obj.matrix_world)

    def update(self, obj: bpy.types.Object) -> None:
        start = time.perf_counter()
        with arrays.current_mesh(obj):
            self.value = self._compute(obj, faces.read_faces(obj, self.wanted[0]))
        self.key, self.seconds = self.wanted, time.perf_counter() - start


def active_stats(obj: bpy.types.Object) -> LogoStats | None:
    """Figures of the active logo; None where the mesh has none, or while they are first computed."""
    key = _key(obj)
    return _stats.get(obj, key) if key is not None else None


@between_strokes(REST)
def _catch_up() -> float | None:
    """Timer: compute what was requested last, once the user pauses."""
    obj, late = bpy.context.object, [kept for kept in (_stats, _tint, _outline) if kept.wanted != kept.key]
    if not late or obj is None or obj.type != "MESH" or not obj.data:
        return None
    # Half a million faces take seconds: they wait for as long a rest, so that at most half of the time goes into them.
    seconds = sum(kept.seconds for kept in late)
    if seconds >= BLINK and time.monotonic() - session.mesh_changed_at < max(REST, seconds):
        return REST
    key = _key(obj)
    if key is None:
        return None
    with arrays.current_mesh(obj):  # one copy for all
        for kept in late:
            kept.wanted = key
            kept.update(obj)
    redraw()
    return None


def worn_parts(obj: bpy.types.Object, mask: np.ndarray) -> list[tuple[bpy.types.Object, np.ndarray]]:
    """The body and what the camera sees on it, each with its faces of the active logo."""
    return [(obj, mask), *((o, logo_mask(o, _active(obj))) for o in worn_by(obj))]


def worn_tint(obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
    """`tint_triangles` of the body and of its clothing, in the body's space."""
    back, logo = np.array(obj.matrix_world.inverted_safe()), _active(obj)
    wearing = [(o, on_it) for o, on_it in worn_parts(obj, mask) if on_it.any()]
    tints = [arrays.to_world(tint_triangles(o, on_it, logo), back @ np.array(o.matrix_world)) for o, on_it in wearing]
    return np.concatenate([np.zeros((0, 3)), *tints])


def tint_triangles(obj: bpy.types.Object, mask: np.ndarray, logo: str = "") -> np.ndarray:
    """[3 n, 3] float32: corners of the logo's triangles in the object's space, lifted off the surface."""
    with arrays.current_mesh(obj) as mesh:
        if obj.mode == "EDIT":
            mask = mask & ~arrays.hidden_faces(mesh)
        else:
            mesh, mask = _shown_mesh(obj, mask, logo)
        return _lifted(obj, mesh, arrays.mesh_triangles(mesh, mask)[0].ravel(), LIFT)


def outline_edges(obj: bpy.types.Object, mask: np.ndarray) -> np.ndarray:
    """[2 n, 3] float32: ends of the edges around the logo in the object's space, lifted off the surface."""
    mesh, mask = _shown_mesh(obj, mask)
    edges = arrays.corner_edges(mesh)[np.repeat(mask, arrays.corner_counts(mesh))]
    around = np.flatnonzero(np.bincount(edges, minlength=len(mesh.edges)) == 1)
    return _lifted(obj, mesh, arrays.read(mesh.edges, "vertices", 2, np.int32)[around].ravel(), 2 * LIFT)


def _lifted(obj: bpy.types.Object, mesh: bpy.types.Mesh, chosen: np.ndarray, lift: float) -> np.ndarray:
    """[n, 3] float32: places of vertices [n], moved outwards by a share of the body's largest extent."""
    size = max(obj.dimensions) / max(max(abs(s) for s in obj.matrix_world.to_scale()), 1e-9)
    # Normals of the vertices: with the faces' own, edges would gape.
    normals = arrays.read(mesh.vertex_normals, "vector", 3)[chosen]
    return (arrays.vertex_points(mesh)[chosen] + lift * size * normals).astype(np.float32)


def _shown_mesh(obj: bpy.types.Object, mask: np.ndarray, logo: str = "") -> tuple[bpy.types.Mesh, np.ndarray]:
    """The mesh that viewports show, and the faces of the logo (the active one, unless named) on it.

    Where modifiers make other faces: the logo as its attribute arrives there, else on the rest shape.
    """
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    if len(mesh.polygons) == len(mask):
        return mesh, mask
    attribute = mesh.attributes.get(logo or _active(obj))
    if attribute is None or attribute.domain != "FACE":
        return obj.data, mask
    return mesh, arrays.read(attribute.data, "value", dtype=bool)


_stats = _Kept(lambda obj, mask: logo_stats(worn_parts(obj, mask)))
_tint, _outline = _Kept(worn_tint), _Kept(outline_edges)


def _draw() -> None:
    """Viewport callback."""
    obj, overlays = bpy.context.object, bpy.context.space_data.overlay.show_overlays
    if not overlays or not bpy.context.scene.cloak.tint or obj is None or obj.type != "MESH" or not obj.visible_get():
        return
    key = _key(obj) if obj.data.polygons else None
    if key is None:
        return
    # Which colours of ours this viewport shows: a tint would falsify trained colours and hide a heat map.
    shading = bpy.context.space_data.shading
    if shading.type == "SOLID":
        roles = (COLORS, HEATMAP) if shading.color_type == "VERTEX" else ()
        shown = next((role for role in roles if colors.shows(obj, role)), "")
    else:
        shown = COLORS if colors.is_dressed(obj) else ""
    # Who is at work on the logo must see its outline on a worn cloak too.
    tool = bpy.context.workspace.tools.from_space_view3d_mode(bpy.context.mode, create=False)
    edits = obj.mode == "EDIT" or (tool is not None and tool.idname == PAINT)
    if shown == HEATMAP or (shown == COLORS and edits):
        _outline.draw(obj, key, "LINES", OUTLINE)
    elif shown != COLORS:
        _tint.draw(obj, key, "TRIS", TINT)


@persistent
def _on_change(scene: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    """Note changes; selecting or moving an object changes no logo.

    Links, parents and instances, which may concern any object, update a scene and objects, or a collection, together; a
    scene alone tells what is selected or hidden.
    """
    meshes, ids = (bpy.types.Object, bpy.types.Mesh), [update.id.original for update in graph.updates]
    shapes = any(update.is_updated_geometry and isinstance(update.id, meshes) for update in graph.updates)
    changed = {one for one in ids if isinstance(one, bpy.types.Object)}
    whole = (bpy.types.Scene, bpy.types.Collection) if changed else bpy.types.Collection
    session.note_change(shapes, changed if ids and not any(isinstance(one, whole) for one in ids) else None)


_note_change = persistent(lambda *_: session.note_change(geometry=True))


def _forget() -> None:
    if bpy.app.timers.is_registered(_catch_up):
        bpy.app.timers.unregister(_catch_up)
    for kept in (_stats, _tint, _outline):
        kept.clear()


HOOKS = Hooks(
    ("depsgraph_update_post", _on_change),
    *((name, _note_change) for name in ("frame_change_post", "load_post", "undo_post", "redo_post")),
    drawing=((_draw, "POST_VIEW"),),
    closing=_forget,
)


class Preview(Hooks):
    """Drawn in every 3D viewport from `register` to `unregister`; without a window nothing is drawn."""

    def __init__(self, surface: Surface, color: tuple[float, float, float, float]) -> None:
        self._surface, self._color = surface, color
        self._shapes: list[Shape] = []
        self._lift = LIFT * float(np.ptp(surface.points, axis=0).max())
        draw = lambda: [shape.draw() for shape in self._shapes]
        super().__init__(drawing=((draw, "POST_VIEW"),), closing=self._shapes.clear)

    def show(self, faces: np.ndarray, alone: bool) -> None:
        """Show these evaluated faces, alone or as well."""
        if alone:
            self._shapes.clear()
        if bpy.app.background or not len(faces):
            return
        surface = self._surface
        triangles, face = surface.triangles(faces)
        normals = surface.normals[face]
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        corners = surface.points[triangles] + self._lift * normals[:, None]
        self._shapes.append(Shape("TRIS", corners.reshape(-1, 3) + surface.middle, self._color))
