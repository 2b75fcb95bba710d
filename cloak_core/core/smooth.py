"""Smoothing: colours are averages over neighbouring faces, so that only low frequencies are learnt."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int

from cloak_core.core.linear import SparseMap, offsets


def neighbour_means(edges: Int[np.ndarray, "E 2"], count: int, device: torch.device | str = "cpu") -> SparseMap:
    """Make the map in which each of `count` faces takes a share of its neighbours' values.

    Face i takes 1 / (1 + max(d_i, d_j)) of neighbour j, d the numbers of neighbours, and keeps the rest (Metropolis
    and Hastings' weights): a symmetric matrix W whose rows sum to 1. So values stay within the bounds they had, the
    mean colour stays, and the gradient goes through the same matrix. edges: positions of two neighbouring faces.
    """
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
    return SparseMap(offsets(rows, count), columns, values.float(), count)


def smoothed(values: Float[torch.Tensor, "L C"], means: SparseMap, rounds: int) -> Float[torch.Tensor, "L C"]:
    """Average values over neighbours, `rounds` times; they stay within [0, 1] where the given ones do."""
    mean = values
    for _ in range(rounds):
        mean = means(mean)
    # Rounding may carry a mean a hair beyond what it is the mean of; the gradient passes.
    return mean + (mean.clamp(0, 1) - mean).detach()
