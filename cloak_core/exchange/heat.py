"""Which faces a heat map points at: one rule for the command line and for Blender."""

from __future__ import annotations

import numpy as np

from ..files.errors import InputError


def hottest_faces(heat: np.ndarray, areas: np.ndarray, share: float) -> np.ndarray:
    """[L] int64 sorted ids of the faces with the most heat per area that make up `share` of the area of all.

    Heat [F] is not negative, areas [F] are in any unit. Per area, because a large face gathers gradient from more
    pixels: what counts is the gain of each square metre. Faces without heat are never taken, so there may be less area
    than was asked for. InputError: a share outside (0, 1], a heat map of another body, no heat at all.
    """
    if not 0 < share <= 1:
        raise InputError(f"a share of {share} of the area: one in (0, 1] is needed")
    if len(heat) != len(areas):
        raise InputError(f"a heat map of {len(heat)} faces for a body of {len(areas)}")
    heat, areas = np.asarray(heat, np.float64), np.asarray(areas, np.float64)
    density = np.divide(heat, areas, out=np.zeros(len(heat)), where=areas > 0)
    order = np.argsort(-density, kind="stable")
    order = order[density[order] > 0]
    if not len(order):
        raise InputError("the heat map is zero everywhere: no face moves the detector's score")
    # The last face that still fits by half: the area taken is the nearest to what was asked.
    taken = np.searchsorted(np.cumsum(areas[order]) - areas[order] / 2, share * areas.sum())
    return np.sort(order[: max(1, taken)]).astype(np.int64)
