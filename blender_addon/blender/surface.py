# SPDX-License-Identifier: GPL-3.0-or-later
"""A body's faces as they stand in the viewport, in arrays that answer quickly what a ray hits and what lies around.

Read once when a stroke begins; no tree, because a pass over hundreds of thousands of faces takes numpy milliseconds.
Points that come in and go out are in world space. P evaluated faces, F faces of the mesh itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d
from mathutils import Vector
from mathutils.geometry import closest_point_on_tri, intersect_ray_tri

from ..files.errors import InputError
from . import mesh_arrays as arrays
from .modifiers import carried_faces, lost_reason, numbered_faces


@dataclass(frozen=True)
class Surface:
    """A body at one moment. Coordinates are float32 relative to `middle`, so that they are exact anywhere."""

    middle: np.ndarray
    """[3] float64, in world space."""
    points: np.ndarray
    """[V, 3] vertices."""
    centers: np.ndarray
    """[P, 3]; one axis after the other in memory, so that a pass over them is quick."""
    normals: np.ndarray
    """[P, 3], of any length."""
    reach_squared: np.ndarray
    """[P] from each centre to its farthest corner, and a little more; squared."""
    shown: np.ndarray
    """[P] bool: not hidden."""
    corners: np.ndarray
    """[T, 3] vertices of all triangles."""
    face: np.ndarray
    """[T] the face of each triangle."""
    own: np.ndarray
    """[P] the mesh's own face that each evaluated face comes from, -1 for none."""
    own_count: int
    """F."""

    def triangles(self, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [n, 3] of the triangles of some faces, and the face of each [n]."""
        chosen = np.zeros(len(self.centers), bool)
        chosen[faces] = True
        chosen = chosen[self.face]
        return self.corners[chosen], self.face[chosen]

    def hits(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """[n, 3] where a ray meets shown faces, the nearest first."""
        start = np.asarray(origin, np.float64) - self.middle
        ray = np.asarray(direction, np.float64) / np.linalg.norm(direction)
        offset = self.centers - start.astype(np.float32)
        along = offset @ ray.astype(np.float32)
        aside = np.einsum("ij,ij->i", offset, offset) - along * along
        near = np.flatnonzero((aside <= self.reach_squared) & self.shown)
        near = near[along[near] > -np.sqrt(self.reach_squared[near])]
        corners = self.points[self.triangles(near)[0]].tolist()
        met = (intersect_ray_tri(*map(Vector, points), ray, start) for points in corners)
        distance = np.array([(np.array(place) - start) @ ray for place in met if place is not None])
        return self.middle + start + np.sort(distance[distance > 0])[:, None] * ray

    def under(self, region: bpy.types.Region, view: bpy.types.RegionView3D, mouse: Vector) -> tuple[np.ndarray, Vector]:
        """`hits` of the ray through a pixel of a viewport, and the ray's direction."""
        direction = region_2d_to_vector_3d(region, view, mouse)
        return self.hits(np.array(region_2d_to_origin_3d(region, view, mouse)), np.array(direction)), direction

    def _face_at(self, point: np.ndarray, squared: np.ndarray) -> int:
        """The face at a point relative to `middle`, else the one with the nearest centre; -1 if there is none.

        squared [P]: distances of the centres from the point, squared; infinite for hidden faces.
        """
        near = np.flatnonzero(squared <= self.reach_squared)
        if len(near):
            triangles, face = self.triangles(near)
            nearest = [closest_point_on_tri(Vector(point), *map(Vector, t)) for t in self.points[triangles].tolist()]
            return int(face[np.argmin(_squared(np.array(nearest) - point))])
        return int(np.argmin(squared)) if self.shown.any() else -1

    def around(self, place: np.ndarray, radius: float) -> np.ndarray:
        """The faces whose centres lie within a radius of a place on the surface, and that look to its side; [n]."""
        point = (place - self.middle).astype(np.float32)
        offset = self.centers.T - point[:, None]
        squared = np.where(self.shown, (offset * offset).sum(0), np.float32(np.inf))
        touched = self._face_at(point, squared)
        if touched < 0:
            return np.zeros(0, np.int64)
        near = np.flatnonzero(squared <= radius**2)
        near = near[self.normals[near] @ self.normals[touched] > 0]
        beyond = squared[touched] > max(radius**2, float(self.reach_squared[touched]))
        return near if beyond else np.union1d(near, [touched])

    def own_mask(self, faces: np.ndarray) -> np.ndarray:
        """Mask [F] of the mesh's own faces that some evaluated faces come from."""
        mask = np.zeros(self.own_count, bool)
        own = self.own[faces]
        mask[own[own >= 0]] = True
        return mask


def _squared(vectors: np.ndarray) -> np.ndarray:
    return np.einsum("...j,...j->...", vectors, vectors)


def read_surface(context: bpy.types.Context, obj: bpy.types.Object) -> Surface:
    """The body as it is seen now: posed, and with its modifiers' faces where they come from its own."""
    with arrays.evaluated_mesh(obj, context.evaluated_depsgraph_get()) as (mesh, matrix):
        if len(mesh.polygons) == arrays.face_count(obj):
            return _surface(obj, mesh, matrix, np.arange(len(mesh.polygons)))
    with numbered_faces([obj]), arrays.evaluated_mesh(obj, context.evaluated_depsgraph_get()) as (mesh, matrix):
        own = carried_faces(obj, mesh)
        if own is None:
            raise InputError(lost_reason(obj))
        return _surface(obj, mesh, matrix, own)


def _surface(obj: bpy.types.Object, mesh: bpy.types.Mesh, matrix: np.ndarray, own: np.ndarray) -> Surface:
    placed = arrays.to_world(arrays.vertex_points(mesh), matrix)
    middle = placed.mean(0)
    points = (placed - middle).astype(np.float32)
    corners, face = arrays.mesh_triangles(mesh)
    counts, loops = np.bincount(face, minlength=len(own)) + 2, arrays.corner_vertices(mesh)  # n-gons: n - 2 triangles
    centers = (arrays.to_world(arrays.read(mesh.polygons, "center", 3), matrix) - middle).astype(np.float32)
    normals = arrays.read(mesh.polygon_normals, "vector", 3) @ np.linalg.inv(matrix[:3, :3]).astype(np.float32)
    away = _squared(points[loops] - np.repeat(centers, counts, axis=0))
    reach = 1.001 * np.maximum.reduceat(away, np.cumsum(counts) - counts) + np.float32(1e-12)
    shown = ~arrays.hidden_faces(mesh)
    centers = np.asfortranarray(centers)
    return Surface(middle, points, centers, normals, reach, shown, corners, face, own, arrays.face_count(obj))
