"""What a sample shows, as one number: the depth above the triangle's id; the least is the nearest.

Depth is a 39-bit integer, trunc(nearness * 2^39), where nearness = (e1 * ((n1 - n0) / A) + e2 * ((n2 - n0) / A)) + n0
in float64. Corner 0 is the topmost one (of two the right one), corners 1 and 2 follow clockwise on the screen, and ei
is the edge function that is A at corner i. It does not depend on the order in which a triangle lists its corners, so
identical triangles tie, and ties go to the lower triangle.
"""

from __future__ import annotations

import torch
from jaxtyping import Int64
from torch import Tensor

ID_BITS = 24
DEPTH_BITS = 39
LIMIT = (1 << DEPTH_BITS) - 1
EMPTY = (1 << 63) - 1
"""The key where nothing is."""


def triangle_ids(keys: Int64[Tensor, "*N"]) -> Int64[Tensor, "*N"]:
    """Triangle of each key, -1 for `EMPTY`."""
    return (keys << (64 - ID_BITS)) >> (64 - ID_BITS)


def inverse_depth(keys: Int64[Tensor, "*N"]) -> Tensor:
    """Near plane over view z of each key, float64 in [0, 1] (truncated to `DEPTH_BITS` bits)."""
    return (LIMIT - (keys >> ID_BITS)).to(torch.float64) / (1 << DEPTH_BITS)
