"""Colours as sums over grids of several scales, so that one update moves large areas as readily as single faces.

A Laplacian pyramid (Burt and Adelson, IEEE Transactions on Communications 31(4), 1983) in place of one free colour a
face. Adam moves every parameter about equally far in a step, so that a coarse grid reaches at once what single faces
reach after many steps in one direction: a preconditioner, as a Fourier basis is one (Olah et al., "Feature
Visualization", Distill, 2017).
"""

from __future__ import annotations

import itertools

import numpy as np
import torch
from jaxtyping import Float
from scipy import sparse

from cloak_core.core.linear import SparseMap


def octave_sums(
    points: Float[np.ndarray, "N D"],
    spacing: float,
    count: int,
    period: float | None = None,
    device: torch.device | str = "cpu",
) -> SparseMap:
    """Map the nodes' values of all coarse grids together to their sums at the points.

    Grid k = 1, 2 ... has nodes 2^k times `spacing` apart, and values between them are multilinear. points: of the N
    faces (or squares of a cloth), metres in D dimensions; count: of scales, the faces' own included; period: what
    repeats in every dimension (None: nothing does), into which a whole number of nodes is fitted.
    """
    weights = sparse.hstack([_grid(points, spacing * 2**k, period) for k in range(1, count)], "csr")
    return SparseMap.from_scipy(weights).to(device, torch.float32)


def _grid(points: np.ndarray, spacing: float, period: float | None) -> sparse.csr_matrix:
    """Weights [N, nodes next to a point] of one grid; each row adds up to 1."""
    count = None if period is None else max(1, round(period / spacing))
    at = points / (spacing if count is None else period / count)
    first = np.floor(at).astype(np.int64)
    nodes, weights = [], []
    for corner in itertools.product((0, 1), repeat=points.shape[1]):
        nodes.append(first + corner if count is None else (first + corner) % count)
        weights.append(np.where(corner, at - first, 1 - (at - first)).prod(axis=1))
    used, column = np.unique(np.concatenate(nodes), axis=0, return_inverse=True)
    rows = np.tile(np.arange(len(points)), len(nodes))
    return sparse.csr_matrix((np.concatenate(weights), (rows, column.ravel())), shape=(len(points), len(used)))
