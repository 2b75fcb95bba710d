"""Colours from free parameters by averaging over neighbouring faces: a basis of low frequencies on the mesh."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from cloak_core.render.sparse import csr, offsets


class Smoothing:
    """So many rounds in which each face takes a share of its neighbours' values.

    Face i takes 1 / (1 + max(d_i, d_j)) of neighbour j, d the numbers of neighbours, and keeps the rest (Metropolis
    and Hastings' weights): a symmetric matrix W whose rows sum to 1. So values stay within the bounds they had, the
    mean colour stays, and the gradient goes through the same matrix.
    """

    def __init__(
        self, edges: Int[np.ndarray, "E 2"], count: int, rounds: int, device: torch.device | str = "cpu"
    ) -> None:
        """Build the matrix; edges: positions of two neighbouring faces among the `count`."""
        self.rounds = rounds
        pairs = np.unique(np.sort(edges, axis=1), axis=0)
        degree = np.bincount(pairs.ravel(), minlength=count)
        weight = 1 / (1 + np.maximum(degree[pairs[:, 0]], degree[pairs[:, 1]]))
        own = 1 - np.bincount(pairs.ravel(), np.repeat(weight, 2), count)
        diagonal = np.arange(count)
        row = np.concatenate([pairs[:, 0], pairs[:, 1], diagonal])
        column = np.concatenate([pairs[:, 1], pairs[:, 0], diagonal])
        value = np.concatenate([weight, weight, own])
        order = np.lexsort((column, row))
        rows, columns, values = (torch.from_numpy(x[order]).to(device) for x in (row, column, value))
        self.matrix = csr(offsets(rows, count), columns, values.float(), (count, count))

    def __call__(self, values: Float[Tensor, "L C"]) -> Float[Tensor, "L C"]:
        """Average the values; they stay within [0, 1] where the given ones do."""
        return _Averaged.apply(values, self)

    def averaged(self, values: Float[Tensor, "L C"]) -> Float[Tensor, "L C"]:
        for _ in range(self.rounds):
            values = self.matrix @ values
        return values


class _Averaged(torch.autograd.Function):
    """W applied n times; its gradient is W applied n times."""

    @staticmethod
    def forward(ctx: object, values: Tensor, smoothing: Smoothing) -> Tensor:
        ctx.smoothing = smoothing
        # Rounding may carry a mean a hair beyond what it is the mean of.
        return smoothing.averaged(values).clamp(0, 1)

    @staticmethod
    def backward(ctx: object, upstream: Tensor) -> tuple[Tensor, None]:
        return ctx.smoothing.averaged(upstream), None
