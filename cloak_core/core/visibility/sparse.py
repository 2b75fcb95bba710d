"""Sparse matrices in compressed rows, for products with dense ones."""

from __future__ import annotations

import warnings

import torch
from jaxtyping import Int64
from torch import Tensor

with warnings.catch_warnings():
    # torch says once per process that its sparse matrices are young; users can do nothing with that.
    warnings.simplefilter("ignore")
    torch.sparse_csr_tensor(
        torch.tensor([0, 1]), torch.tensor([0]), torch.tensor([1.0]), (1, 1), check_invariants=False
    )


def csr(crow: Int64[Tensor, " M1"], column: Int64[Tensor, " E"], value: Tensor, size: tuple[int, int]) -> Tensor:
    """Make the matrix with these row offsets, columns and values; nothing is checked."""
    return torch.sparse_csr_tensor(crow, column, value, size, check_invariants=False)


def offsets(rows: Int64[Tensor, " E"], count: int) -> Int64[Tensor, " M1"]:
    """Count row offsets [count + 1] of entries that lie in these rows."""
    result = rows.new_zeros(count + 1)
    result[1:] = torch.bincount(rows, minlength=count).cumsum(0)
    return result
