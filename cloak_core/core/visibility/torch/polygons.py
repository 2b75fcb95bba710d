"""Many convex polygons at once, in torch: cut and measured.

N polygons of up to C corners are one tensor of their coordinates, [C, D, N]; beyond a polygon's size the last of its
corners stands again and again.
"""

from __future__ import annotations

import torch
from jaxtyping import Float64
from torch import Tensor

from cloak_core.core.visibility.clipping import cut

TOUCH = 1e-12
"""Pixels within which a corner counts as lying on a line: rounding stays below 1e-13."""

Line = tuple[Tensor, Tensor, Tensor]
"""a, b and c of each of N lines: a x + b y + c >= 0 on the inner side, in pixels."""


def distances(corners: Float64[Tensor, "C 2 N"], line: Line) -> Float64[Tensor, "C N"]:
    """Compute how far inside a line each corner lies; 0 on it."""
    a, b, c = line
    distance = a * corners[:, 0] + b * corners[:, 1] + c
    return distance.masked_fill(distance.abs() <= TOUCH, 0.0)


def inner_part(corners: Float64[Tensor, "C 2 N"], line: Line) -> Float64[Tensor, "K 2 N"]:
    """Keep the part on the inner side of a line; all corners in one point where nothing does."""
    part, count = cut(corners, distances(corners, line))
    return torch.where(count > 0, part, 0.0)


def join(parts: list[Float64[Tensor, "_ 2 _"]]) -> Float64[Tensor, "C 2 N"]:
    """Polygons beside each other."""
    room = max(len(part) for part in parts)
    return torch.cat([torch.cat([part, part[-1:].expand(room - len(part), -1, -1)]) for part in parts], -1)


def measure(corners: Float64[Tensor, "C 2 N"]) -> Float64[Tensor, "3 N"]:
    """Compute the area, and its first moments in x and y: the area times the centroid."""
    first = corners[0]
    here = corners - first  # about the first corner, so that nothing cancels
    cross = here[:-1, 0] * here[1:, 1] - here[:-1, 1] * here[1:, 0]
    area = cross.sum(0) / 2
    moments = ((here[:-1] + here[1:]) * cross.unsqueeze(1)).sum(0) / 6
    return torch.cat([area.unsqueeze(0), moments + area * first])
