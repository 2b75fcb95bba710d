"""Midpoint subdivision that remembers which polygon every new one came from; which level a camera calls for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from cloak_core.core.cameras import Camera
from cloak_core.core.geometry import sum_by_face
from cloak_core.core.polygons import next_corner, per_corner, polygon_loops, triangulate
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.meshes.mesh_file import mean_of_corners
from cloak_core.sources.bodies.meshes.textures import texture_means

MAX_TRIANGLES = 20_000_000
# Square pixels: below the first a face hardly moves a pixel; above the second it is a visible cell of plain colour.
FINE, COARSE = 0.1, 8.0
MAX_LEVEL = 2


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


def projected_areas(bodies: Bodies, camera: Camera) -> Float[np.ndarray, " faces"]:
    """Compute the screen area of every face in square pixels, as if nothing hid it; backs count nothing. First pose."""
    points = bodies.vertices[0].astype(np.float64)
    pivot = camera.pivot or tuple((points.min(axis=0) + points.max(axis=0)) / 2)
    right, up, back = (np.array(axis) for axis in camera.axes)
    offset = points - camera.position(pivot)
    depth = -(offset @ back)
    if depth.min() <= camera.near_plane:
        raise InputError(f"camera distance {camera.distance}: parts of the body lie behind the camera")
    screen = np.stack([offset @ right, offset @ up], axis=1) * (camera.focal / depth)[:, None]
    a, b, c = screen[bodies.triangles].transpose(1, 0, 2)
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    return sum_by_face(bodies, np.maximum(area, 0))


def resolution(bodies: Bodies, camera: Camera) -> dict[str, float | int | str]:
    """Report on the faces of bodies as a camera sees the first pose.

    faces: how many of them look at the camera, hidden or not; their projected areas in square pixels (median, 10th and
    90th percentile), under_fine: share of those under 0.1 px^2, level: the subdivision level (0 to 2) that this picture
    calls for, and hint: the same in words. InputError: none looks at the camera, or it stands in the body.
    """
    areas = projected_areas(bodies, camera)
    areas = areas[areas > 0]
    if not len(areas):
        raise InputError("no face looks at the camera")
    tenth, median, most = np.percentile(areas, [10, 50, 90])
    under_fine = float((areas < FINE).mean())
    # Each level makes a face a quarter as large; it pays as long as that leaves most faces above the fine limit.
    level = next((n for n in range(MAX_LEVEL) if median / 4**n <= COARSE or median / 4 ** (n + 1) <= FINE), MAX_LEVEL)
    where = f"at distance {camera.distance:g}, {camera.width} x {camera.height} pixels"
    if under_fine > 0.5:
        hint = f"most faces are under {FINE:g} px² {where}: level 1 gains nothing, a coarser mesh would do"
    elif level:
        hint = f"the median face is {median:.3g} px² {where}: level {level} makes it {median / 4**level:.2g} px²"
    else:
        hint = f"the median face is {median:.2g} px² {where}: level 0 is fine enough, level 1 would make it"
        hint += f" {median / 4:.2g}"
    return {
        "faces": len(areas),
        "median": float(median),
        "smallest_tenth": float(tenth),
        "largest_tenth": float(most),
        "under_fine": under_fine,
        "level": level,
        "hint": hint,
    }
