"""Midpoint subdivision that remembers which polygon every new one came from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cloak_core.core.polygons import next_corner, per_corner, polygon_loops, triangulate
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.meshes.mesh_file import mean_of_corners
from cloak_core.sources.bodies.meshes.textures import texture_means

MAX_TRIANGLES = 20_000_000


def subdivide(bodies: Bodies, levels: int = 1) -> tuple[Bodies, np.ndarray]:
    """Split every polygon at its edges' midpoints, `levels` times; the shape stays as it is.

    A polygon of n corners becomes n quads around its centre, as under Blender's Subdivision Surface modifier of type
    Simple; in a mesh of triangles alone each becomes four triangles. Polygons that share an edge share its midpoint, so
    closed bodies stay closed. Outfits, regions and texture coordinates follow.

    Returns the new bodies and `parent` [F'] int64, the old polygon of each new one. Raises `InputError` for a level
    outside 0..6 or a mesh that would grow beyond `MAX_TRIANGLES`.
    """
    if not 0 <= levels <= 6:
        raise InputError(f"subdivision level {levels}: between 0 and 6 is possible")
    if bodies.triangle_count * 4**levels > MAX_TRIANGLES:
        raise InputError(f"subdivision level {levels} of {bodies.triangle_count} triangles: more than {MAX_TRIANGLES}")
    parent = np.arange(bodies.face_count, dtype=np.int64)
    for _ in range(levels):
        bodies, step = split_once(bodies)
        parent = parent[step]
    return bodies, parent


def split_once(bodies: Bodies) -> tuple[Bodies, np.ndarray]:
    """Do one level of `subdivide`."""
    loop_total, loop_vertices, face = polygon_loops(bodies)
    loop_total = loop_total.astype(np.int64)
    all_triangles = bool((loop_total == 3).all())
    split = split_triangles if all_triangles else split_polygons
    corners, total, edges, centres = split(loop_total, loop_vertices, bodies.vertex_count)
    vertices = with_midpoints(bodies.vertices.transpose(1, 0, 2), edges, centres).transpose(1, 0, 2)
    child_corners, child_face = triangulate(vertices[0], total, corners)
    parent = np.repeat(face, 4 if all_triangles else loop_total)
    new = {}
    if bodies.uv is not None:
        uv_corners, _, *uv_points = split(loop_total, per_corner(bodies, bodies.triangle_uv), len(bodies.uv))
        new = {"uv": with_midpoints(bodies.uv, *uv_points), "triangle_uv": uv_corners[child_corners]}
    divided = replace(
        bodies,
        vertices=vertices,
        triangles=corners[child_corners],
        triangle_face=child_face,
        loop_total=total,
        loop_vertices=corners,
        face_colors=bodies.face_colors[:, parent],
        regions={name: mask[parent] for name, mask in bodies.regions.items()},
        recorded_topology=None,
        **new,
    )
    colors = divided.face_colors.copy()
    for outfit in range(divided.outfit_count):
        if (image := divided.texture_of(outfit)) is not None:
            colors[outfit] = texture_means(divided, image)
    return replace(divided, face_colors=colors), parent


Split = tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray] | None]
"""Corners and sizes of the new polygons; what new points are means of: edges [E, 2], and polygons (corners, sizes)
where they get a centre."""


def with_midpoints(values: np.ndarray, edges: np.ndarray, centres: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
    """Compute values [N, ...] of old points, then of edges' midpoints, then of polygons' centres; float32."""
    exact = values.astype(np.float64)
    parts = [exact, exact[edges].mean(axis=1)]
    if centres is not None:
        parts.append(mean_of_corners(exact, centres[1], centres[0]))
    return np.concatenate(parts).astype(np.float32)


def edges_of(loop_total: np.ndarray, loop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """List undirected edges [E, 2], and for each corner the edge that leaves it [C]."""
    ends = np.stack([loop, loop[next_corner(loop_total)]], axis=1).astype(np.int64)
    ends.sort(axis=1)
    # One number per edge: sorting these is several times faster than sorting rows.
    base = int(loop.max()) + 1 if len(loop) else 1
    keys, edge = np.unique(ends[:, 0] * base + ends[:, 1], return_inverse=True)
    return np.stack([keys // base, keys % base], axis=1), edge


def split_polygons(loop_total: np.ndarray, loop: np.ndarray, point_count: int) -> Split:
    """Split a polygon into n quads, one a corner: (corner, next midpoint, centre, previous midpoint)."""
    edges, edge = edges_of(loop_total, loop)
    face = np.repeat(np.arange(len(loop_total)), loop_total)
    previous = np.empty(len(loop), np.int64)
    previous[next_corner(loop_total)] = np.arange(len(loop))
    middle = point_count + edge
    centre = point_count + len(edges) + face
    quads = np.stack([loop, middle, centre, middle[previous]], axis=1)
    return quads.reshape(-1), np.full(len(loop), 4), edges, (loop, loop_total)


def split_triangles(loop_total: np.ndarray, loop: np.ndarray, point_count: int) -> Split:
    """Split each triangle into four: one at each corner and the middle one."""
    edges, edge = edges_of(loop_total, loop)
    a, b, c = loop.reshape(-1, 3).T.astype(np.int64)
    ab, bc, ca = point_count + edge.reshape(-1, 3).T
    four = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], axis=1)
    return four.reshape(-1), np.full(4 * len(loop_total), 3), edges, None
