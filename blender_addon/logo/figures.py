# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures of a logo for the panel: its area, and how much of it a camera in front sees (in parallel projection)."""

from dataclasses import dataclass

import bpy
import numpy as np

from ..blender.mesh_arrays import current_mesh, hidden_faces, mesh_triangles, to_world, triangle_areas, vertex_points
from ..blender.occlusion import depth_buffer

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
        with current_mesh(obj) as mesh:
            hides, seen_mesh = hidden_faces(mesh), mesh
            if obj.mode != "EDIT":  # as viewports show it where modifiers keep the faces, else as it is without them
                evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
                seen_mesh = evaluated if len(evaluated.polygons) == len(mesh.polygons) else mesh
            points = to_world(vertex_points(seen_mesh), np.array(obj.matrix_world))
            corners, face = mesh_triangles(seen_mesh)
        hidden += int((mask & hides).sum())
        area = triangle_areas(points, corners)
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
