"""The one sparse map: rows x columns, constant in every gradient.

Whatever is linear between the colours and the pixels is such a map: faces to pixels, squares of a cloth to places on
it, grids to faces, neighbours to their mean. Maps compose (`@`), and applying one is differentiable in the values.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int64
from scipy import sparse
from torch import Tensor

with warnings.catch_warnings():
    # torch says once per process that its sparse matrices are young; users can do nothing with that.
    warnings.simplefilter("ignore")
    torch.sparse_csr_tensor(
        torch.tensor([0, 1]), torch.tensor([0]), torch.tensor([1.0]), (1, 1), check_invariants=False
    )


@dataclass(frozen=True, eq=False)
class SparseMap:
    """A sparse matrix in compressed rows (CSR). Nothing is checked: whoever makes one answers for its indices."""

    crow: Int64[Tensor, " R1"]
    """R + 1 offsets of the rows' entries."""
    column: Int64[Tensor, " E"]
    weight: Float[Tensor, " E"]
    width: int
    """Number of columns."""

    @property
    def height(self) -> int:
        """Number of rows."""
        return len(self.crow) - 1

    def __len__(self) -> int:
        """Count the entries."""
        return len(self.column)

    @cached_property
    def row(self) -> Int64[Tensor, " E"]:
        """The row of each entry."""
        return torch.repeat_interleave(self.crow.diff(), output_size=len(self))

    @cached_property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Row offsets, columns and weights as numpy arrays for loops; the same memory."""
        return tuple(tensor.contiguous().numpy() for tensor in (self.crow, self.column, self.weight))

    @cached_property
    def matrix(self) -> Tensor:
        """The same as a torch CSR tensor [R, C]."""
        size = (self.height, self.width)
        return torch.sparse_csr_tensor(self.crow, self.column, self.weight, size, check_invariants=False)

    @cached_property
    def transposed(self) -> SparseMap:
        """The map's transpose; within a row, entries keep their order."""
        order = torch.argsort(self.column, stable=True)
        crow = offsets(self.column, self.width)
        return SparseMap(crow, self.row.index_select(0, order), self.weight.index_select(0, order), self.height)

    def __call__(self, values: Float[Tensor, "C K"]) -> Float[Tensor, "R K"]:
        """Apply the map to values, differentiably: the gradient is a product with the transpose."""
        return _Product.apply(values, self)

    def __matmul__(self, other: SparseMap) -> SparseMap:
        """Compose two maps, this one after the other. Entries of one place are summed, columns ascend within rows."""
        if self.crow.device.type == "cpu":
            return SparseMap.from_scipy(self.to_scipy() @ other.to_scipy())
        product = torch.sparse.mm(self.matrix, other.matrix)
        return SparseMap(product.crow_indices(), product.col_indices(), product.values(), other.width)

    def scaled(self, factor: Float[Tensor, " R"]) -> SparseMap:
        """Multiply each row by a factor."""
        return replace(self, weight=self.weight * factor.index_select(0, self.row))

    def row_sums(self) -> Float[Tensor, " R"]:
        """Sum the weights of each row."""
        return self.weight.new_zeros(self.height).index_add_(0, self.row, self.weight)

    def to(self, device: torch.device | str, dtype: torch.dtype | None = None) -> SparseMap:
        """Copy the map to a device, its weights to a type."""
        weight = self.weight.to(device, dtype or self.weight.dtype)
        return SparseMap(self.crow.to(device), self.column.to(device), weight, self.width)

    def to_scipy(self) -> sparse.csr_matrix:
        """Give a scipy matrix that shares the memory."""
        crow, column, weight = self.arrays
        return sparse.csr_matrix((weight, column, crow), shape=(self.height, self.width))

    @staticmethod
    def from_scipy(matrix: sparse.spmatrix) -> SparseMap:
        """Make a map of a scipy matrix; columns ascend within rows."""
        matrix = matrix.tocsr()
        matrix.sort_indices()
        crow = torch.from_numpy(matrix.indptr.astype(np.int64))
        column = torch.from_numpy(matrix.indices.astype(np.int64))
        return SparseMap(crow, column, torch.from_numpy(matrix.data), matrix.shape[1])

    @staticmethod
    def stacked(parts: Sequence[SparseMap]) -> SparseMap:
        """Put maps of equal width below each other."""
        if len(parts) == 1:
            return parts[0]
        starts = [0, *itertools.accumulate(len(part) for part in parts)]
        crow = torch.cat([part.crow[i > 0 :] + starts[i] for i, part in enumerate(parts)])
        column = torch.cat([part.column for part in parts])
        return SparseMap(crow, column, torch.cat([part.weight for part in parts]), parts[0].width)

    @staticmethod
    def blocks(parts: Sequence[SparseMap]) -> SparseMap:
        """Put maps along the diagonal of one."""
        if len(parts) == 1:
            return parts[0]
        width = sum(part.width for part in parts)
        starts = [0, *itertools.accumulate(part.width for part in parts)]
        moved = [replace(part, column=part.column + starts[i], width=width) for i, part in enumerate(parts)]
        return SparseMap.stacked(moved)


class _Product(torch.autograd.Function):
    """A product with a constant sparse matrix, and its gradient with the transposed one."""

    @staticmethod
    def forward(ctx: object, values: Tensor, applied: SparseMap) -> Tensor:
        ctx.applied = applied
        return applied.matrix @ values

    @staticmethod
    def backward(ctx: object, upstream: Tensor) -> tuple[Tensor, None]:
        return ctx.applied.transposed.matrix @ upstream, None


def offsets(rows: Int64[Tensor, " E"], count: int) -> Int64[Tensor, " R1"]:
    """Count row offsets [count + 1] of entries that lie in these rows."""
    result = rows.new_zeros(count + 1)
    result[1:] = torch.bincount(rows, minlength=count).cumsum(0)
    return result
