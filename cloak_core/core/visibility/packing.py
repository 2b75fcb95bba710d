"""Packed depth and id: one integer per sample, depth above the triangle's id; the least is the nearest.

Depth is a 39-bit integer, trunc(n * 2^39), of the inverse depth n = (e1 * ((n1 - n0) / A) + e2 * ((n2 - n0) / A)) + n0
in float64. Corner 0 is the topmost one (of two the right one), corners 1 and 2 follow clockwise on the screen, and ei
is the edge function that is A at corner i. The result does not depend on the order in which a triangle lists its
corners: identical triangles tie, and ties go to the lower id.
"""

from __future__ import annotations

from jaxtyping import Int64
from torch import Tensor

ID_BITS = 24
DEPTH_BITS = 39
LIMIT = (1 << DEPTH_BITS) - 1
EMPTY = (1 << 63) - 1
"""The packed value where nothing is."""


def triangle_ids(packed: Int64[Tensor, "*N"]) -> Int64[Tensor, "*N"]:
    """Unpack the triangle ids, -1 for `EMPTY`."""
    return (packed << (64 - ID_BITS)) >> (64 - ID_BITS)
