# SPDX-License-Identifier: GPL-3.0-or-later
"""Stamps: project a text, a picture or a smiley onto the body and take the faces it covers.

A stamp is a bool array [H, W], row 0 at the top, True where there is ink.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..blender.mesh_arrays import (
    evaluated_mesh,
    face_centers,
    face_count,
    face_normals,
    face_triangles,
    hidden_faces,
    image_pixels,
    mesh_triangles,
    polygon_loops,
    read,
    vertex_points,
)
from ..blender.modifiers import carried_faces, lost_reason, numbered_faces
from ..blender.occlusion import ranges, seen
from ..files.errors import InputError

RESOLUTION = 512


def text_stamp(text: str) -> np.ndarray:
    """A line of text in Blender's own font."""
    if not text.strip():
        raise InputError("The stamp's text is empty: type a letter or a word")
    curve = bpy.data.curves.new("cloak stamp", "FONT")
    carrier = bpy.data.objects.new("cloak stamp", curve)
    try:
        curve.body = text
        mesh = carrier.to_mesh()
        if mesh is None or not len(mesh.polygons):
            raise InputError(f"Nothing to see in the text '{text}': the font has no such letters")
        return _fill(read(mesh.vertices, "co", 3)[:, :2], mesh_triangles(mesh)[0])
    finally:
        carrier.to_mesh_clear()
        bpy.data.objects.remove(carrier)
        bpy.data.curves.remove(curve)


def _fill(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    low, high = points.min(0), points.max(0)
    scale = RESOLUTION / max(high - low)
    width, height = np.maximum(1, np.ceil((high - low) * scale)).astype(int)
    pixels = (points - low) * scale
    row, left, right = _spans(pixels[triangles])
    row, left, right = (values[(row >= 0) & (row < height) & (left <= right)] for values in (row, left, right))
    steps = np.zeros((height, width + 1), np.int32)
    np.add.at(steps, (row, np.clip(left, 0, width)), 1)
    np.add.at(steps, (row, np.clip(right + 1, 0, width)), -1)
    return (steps.cumsum(1)[:, :width] > 0)[::-1]


def _spans(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of triangles [T, 3, 2]: each row of pixels that one crosses, and the first and last pixel covered there."""
    low = np.ceil(triangles[..., 1].min(1) - 0.5).astype(np.int64)
    high = np.floor(triangles[..., 1].max(1) - 0.5).astype(np.int64)
    triangle, row = ranges(np.arange(len(triangles)), low, np.maximum(high - low + 1, 0))
    start, end = triangles[triangle], np.roll(triangles, -1, axis=1)[triangle]
    with np.errstate(divide="ignore", invalid="ignore"):  # level sides meet no row, or all of it
        along = (row[:, None] + 0.5 - start[..., 1]) / (end[..., 1] - start[..., 1])
        x = start[..., 0] + along * (end[..., 0] - start[..., 0])
    met = (along >= 0) & (along <= 1)
    left, right = np.where(met, x, np.inf).min(1), np.where(met, x, -np.inf).max(1)
    some = met.any(1)
    first, last = np.ceil(left[some] - 0.5), np.floor(right[some] - 0.5)
    return row[some], first.astype(np.int64), last.astype(np.int64)


def smiley_stamp() -> np.ndarray:
    """A ring with two eyes and a mouth."""
    y, x = 1 - 2 * (np.mgrid[:RESOLUTION, :RESOLUTION] + 0.5) / RESOLUTION
    x = -x
    radius = np.hypot(x, y)
    ring = (radius <= 1) & (radius >= 0.78)
    eyes = np.hypot((np.abs(x) - 0.32) / 0.8, y - 0.25) <= 0.17
    mouth = (np.hypot(x, y) <= 0.60) & (np.hypot(x, y) >= 0.38) & (y < -0.12)
    return ring | eyes | mouth


def image_stamp(image: bpy.types.Image | None) -> np.ndarray:
    """The dark, opaque pixels of an image."""
    if image is None:
        raise InputError("No picture chosen: open one under Stamp > Image")
    if not image.size[0] or not image.size[1]:
        raise InputError(f"Picture '{image.name}' cannot be read: reload it or choose another")
    pixels = image_pixels(image)[::-1]
    opaque = pixels[..., 3] > 0.5 if image.channels == 4 else np.ones(pixels.shape[:2], bool)
    ink = opaque & (pixels[..., : min(3, image.channels)].mean(-1) < 0.5)
    if not ink.any():
        raise InputError(f"Picture '{image.name}' has no dark, opaque pixels: those are the ink of a stamp")
    return ink


@dataclass(frozen=True)
class Projection:
    """How points in world space become stamp coordinates: `to_plane` gives (x, y) with the stamp inside +-1."""

    to_plane: Matrix
    """4x4; the result is divided by its w, so perspective views work too."""
    eye: Vector | None
    """Where rays come from; None for a parallel projection along `direction`."""
    direction: Vector
    """Into the scene."""


def front_projection(obj: bpy.types.Object, size: float, center: float, offset: float, aspect: float) -> Projection:
    """Straight onto the front. `size` (stamp height), `center` and `offset` are shares of the body's height."""
    corners = np.array([obj.matrix_world @ Vector(corner) for corner in obj.bound_box])
    low, high = corners.min(0), corners.max(0)
    tall = max(float(high[2] - low[2]), 1e-9)
    half = 0.5 * size * tall
    x, z = float(low[0] + high[0]) / 2 + offset * tall, float(low[2]) + center * tall
    to_plane = Matrix(
        ((1 / (half * aspect), 0, 0, -x / (half * aspect)), (0, 0, 1 / half, -z / half), (0,) * 4, (0, 0, 0, 1))
    )
    return Projection(to_plane, None, Vector((0, 1, 0)))


def view_projection(region: bpy.types.Region, view: bpy.types.RegionView3D, size: float, aspect: float) -> Projection:
    """From the viewport, the stamp in its middle; `size` is a share of the viewport's height."""
    inverse = view.view_matrix.inverted()
    scale = Matrix.Diagonal((region.width / region.height / (size * aspect), 1 / size, 1, 1))
    eye = inverse.translation if view.is_perspective else None
    return Projection(scale @ view.perspective_matrix, eye, -inverse.to_3x3().col[2])


def covered_faces(
    context: bpy.types.Context, obj: bpy.types.Object, stamp: np.ndarray, projection: Projection
) -> np.ndarray:
    """Mask [F] of the faces whose centre lies under ink, that look at the viewer and that nothing on the body hides."""
    graph = context.evaluated_depsgraph_get()
    with evaluated_mesh(obj, graph) as (mesh, matrix):
        same = len(mesh.polygons) == face_count(obj)
        own = np.flatnonzero(_covered(mesh, matrix, stamp, projection)) if same else None
    if own is None:
        own = _covered_own(context, obj, stamp, projection)
    if not len(own):
        raise InputError("The stamp covers no visible face: change its size or place, or the view")
    mask = np.zeros(face_count(obj), bool)
    mask[own] = True
    return mask


def _covered_own(
    context: bpy.types.Context, obj: bpy.types.Object, stamp: np.ndarray, projection: Projection
) -> np.ndarray:
    """The mesh's own faces that the covered ones come from, where modifiers make other faces."""
    with numbered_faces([obj]), evaluated_mesh(obj, context.evaluated_depsgraph_get()) as (mesh, matrix):
        own = carried_faces(obj, mesh)
        if own is None:
            raise InputError(lost_reason(obj))
        covered = own[_covered(mesh, matrix, stamp, projection)]
    return np.unique(covered[covered >= 0])


def _covered(mesh: bpy.types.Mesh, matrix: np.ndarray, stamp: np.ndarray, projection: Projection) -> np.ndarray:
    """Mask [P] of an evaluated mesh's covered polygons."""
    centers, normals = face_centers(vertex_points(mesh), *polygon_loops(mesh)), face_normals(mesh)
    back = np.linalg.inv(matrix)  # whether a face looks at the viewer is the same in the mesh's own space
    if projection.eye is None:
        facing = normals @ (back[:3, :3] @ np.array(projection.direction)).astype(np.float32) < 0
    else:
        eye = (back[:3, :3] @ np.array(projection.eye) + back[:3, 3]).astype(np.float32)
        facing = np.einsum("ij,ij->i", normals, centers - eye) < 0
    plane, before_eye = _to_plane(centers, matrix, projection)
    mask = before_eye & facing & under_ink(plane, stamp) & ~hidden_faces(mesh)
    ids = np.flatnonzero(mask)
    if len(ids):
        mask[ids] = seen(plane[ids], ids, *_image(mesh, matrix, projection, plane, ids))
    return mask


def _image(
    mesh: bpy.types.Mesh, matrix: np.ndarray, projection: Projection, plane: np.ndarray, ids: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mesh's vertices in plane coordinates [V, 3], its triangles before the eye [T, 3], and the face of each.

    Of the faces, whose centres lie at `plane` [P, 3], only those that may lie before the faces `ids`.
    """
    points, before_eye = _to_plane(vertex_points(mesh), matrix, projection)
    counts, loops = polygon_loops(mesh)
    starts = np.cumsum(counts) - counts
    low, high = plane[ids, :2].min(0), plane[ids, :2].max(0)
    sides = (points[:, :2] < low) * np.uint8([1, 2]) + (points[:, :2] > high) * np.uint8([4, 8])
    behind = (points[:, 2] < plane[ids, 2].min()) * np.uint8(16)
    aside = np.bitwise_and.reduceat((sides[:, 0] | sides[:, 1] | behind)[loops], starts)  # all corners beyond one side
    usable = np.logical_and.reduceat(before_eye[loops], starts)
    return (points, *face_triangles(mesh, (aside == 0) & usable))


def _to_plane(points: np.ndarray, matrix: np.ndarray, projection: Projection) -> tuple[np.ndarray, np.ndarray]:
    """Points [n, 3] of a mesh as x, y in the stamp's plane and nearness; and which lie before the eye."""
    rows = np.array(projection.to_plane, np.float64) @ matrix
    if projection.eye is None:  # a parallel view: w is 1 everywhere, and nearness a coordinate like the others
        toward = -np.array(projection.direction, np.float64) @ matrix[:3]
        rows = np.stack([rows[0], rows[1], toward])
        return points @ rows[:, :3].T + rows[:, 3], np.ones(len(points), bool)
    plane = points @ rows[[0, 1, 3], :3].T + rows[[0, 1, 3], 3]
    before_eye = plane[:, 2] > 1e-9
    plane[:, 2] = 1 / np.where(before_eye, plane[:, 2], 1)  # linear in the image
    plane[:, :2] *= plane[:, 2:]
    return plane, before_eye


def under_ink(plane: np.ndarray, stamp: np.ndarray) -> np.ndarray:
    """Mask [n] of the points [n, 2 or more], the stamp inside +-1, that lie under ink."""
    height, width = stamp.shape
    column = np.floor((plane[:, 0] + 1) / 2 * width).astype(int)
    row = np.floor((1 - plane[:, 1]) / 2 * height).astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return inside & stamp[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
