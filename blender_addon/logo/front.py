# SPDX-License-Identifier: GPL-3.0-or-later
"""What a camera in front sees of a logo: a depth buffer of the body and of what it wears, in parallel projection."""

from __future__ import annotations

import bpy
import numpy as np

from ..blender.mesh_arrays import current_mesh, face_triangles, hidden_faces, to_world, vertex_points
from ..blender.occlusion import depth_buffer

PIXELS = 320
"""Along the longest side of what is worn and body: 6 mm of a person."""
WORTH_TELLING = 0.05
"""Share of the logo from which on a piece that covers it is named."""
Part = tuple[bpy.types.Object, np.ndarray]
"""An object, and the mask [F] of the logo's faces on it; the body comes first."""


def seen(parts: list[Part]) -> dict[str, object]:
    """Areas of the logo and of the whole outline from the front, square metres, and who covers which share of it."""
    shapes = [_in_plane(obj) for obj, _ in parts]
    low = np.min([points[:, :2].min(0) for points, _, _ in shapes], axis=0)
    high = np.max([points[:, :2].max(0) for points, _, _ in shapes], axis=0)
    cell = max(float((high - low).max()), 1e-9) / PIXELS
    shape = tuple(np.maximum(1, np.ceil((high - low) / cell)).astype(int).tolist())
    drawn = [depth_buffer((points - [*low, 0]) / [cell, cell, 1], triangles, shape) for points, triangles, _ in shapes]
    depths, on_logo = [], []
    for (_, mask), (_, _, face), (depth, triangle) in zip(parts, shapes, drawn, strict=True):
        depths.append(depth)
        known = np.concatenate([mask, [False]])[face] if len(mask) else np.zeros(len(face), bool)
        on_logo.append((triangle >= 0) & (known[triangle] if len(known) else False))
    wearing = [index for index, (_, mask) in enumerate(parts) if index == 0 or mask.any()]
    nearest = np.argmax(depths, axis=0)
    square = (cell * bpy.context.scene.unit_settings.scale_length) ** 2
    visible = np.take_along_axis(np.array(on_logo), nearest[None], 0)[0]
    bare_depth = np.max([depths[i] for i in wearing], axis=0)
    bare_owner = np.argmax([depths[i] for i in wearing], axis=0)
    bare = np.take_along_axis(np.array([on_logo[i] for i in wearing]), bare_owner[None], 0)[0]
    covered = []
    for index, (obj, _) in enumerate(parts):
        share = float((bare & (depths[index] > bare_depth)).sum() / max(1, bare.sum()))
        if index not in wearing and share >= WORTH_TELLING:
            covered.append((obj.name, share))
    return {
        "projected_area": float(visible.sum() * square),
        "whole_projected_area": float(np.isfinite(np.max(depths, axis=0)).sum() * square),
        "covered": tuple(covered),
    }


def _in_plane(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices [V, 3] as right, up and towards the viewer; triangles [T, 3]; the mesh's own face of each [T].

    As viewports show it where modifiers keep the faces, else the mesh as it is without them.
    """
    with current_mesh(obj) as mesh:
        if obj.mode != "EDIT":
            shown = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
            mesh = shown if len(shown.polygons) == len(mesh.polygons) else mesh
        points = to_world(vertex_points(mesh), np.array(obj.matrix_world))
        triangles, face = face_triangles(mesh, None if obj.mode != "EDIT" else ~hidden_faces(mesh))
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], -1), triangles, face
