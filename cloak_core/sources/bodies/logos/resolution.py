"""How large faces are in the picture, and which subdivision level that calls for."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from cloak_core.core.cameras import Camera
from cloak_core.core.geometry import sum_by_face
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError

# Square pixels: below the first a face hardly moves a pixel; above the second it is a visible cell of plain colour.
FINE, COARSE = 0.1, 8.0
MAX_LEVEL = 2


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
