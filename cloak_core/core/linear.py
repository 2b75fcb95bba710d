"""Linear maps, constant in every gradient: sparse matrices, and chains of maps that are applied one after the other.

Whatever is linear between the colours and the pixels is such a map: places on clothes to pixels, colours of a pattern
to places, grids to faces, neighbours to their mean. Maps compose (`@`).
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int64
from scipy import sparse
from torch import Tensor

from cloak_core.core.visibility.compiled import loop, use_loops

with warnings.catch_warnings():
    # torch says once per process that its sparse matrices are young; users can do nothing with that.
    warnings.simplefilter("ignore")
    torch.sparse_csr_tensor(
        torch.tensor([0, 1]), torch.tensor([0]), torch.tensor([1.0]), (1, 1), check_invariants=False
    )


@runtime_checkable
class LinearMap(Protocol):
    """What a `SparseMap` and a `Chain` have in common."""

    @property
    def height(self) -> int: ...

    @property
    def width(self) -> int: ...

    def apply(self, values: Float[Tensor, "C K"]) -> Float[Tensor, "R K"]:
        """Map values, without a graph."""

    def adjoint(self, upstream: Float[Tensor, "R K"]) -> Float[Tensor, "C K"]:
        """Map a gradient back, without a graph."""

    def __matmul__(self, other: SparseMap) -> LinearMap:
        """Compose two maps, this one after the other."""


@dataclass(frozen=True, eq=False)
class Chain:
    """Two maps applied in turn: cheaper than their product where it is used once."""

    outer: LinearMap
    inner: SparseMap

    @property
    def height(self) -> int:
        """Number of rows."""
        return self.outer.height

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.inner.width

    def apply(self, values: Float[Tensor, "C K"]) -> Float[Tensor, "R K"]:
        """See `LinearMap`."""
        return self.outer.apply(self.inner.apply(values))

    def adjoint(self, upstream: Float[Tensor, "R K"]) -> Float[Tensor, "C K"]:
        """See `LinearMap`."""
        return self.inner.adjoint(self.outer.adjoint(upstream))

    def __matmul__(self, other: SparseMap) -> Chain:
        return Chain(self.outer, self.inner @ other)


@dataclass(frozen=True, eq=False)
class SparseMap:
    """A sparse matrix in compressed rows (CSR). Nothing is checked: whoever makes one answers for its indices."""

    crow: Int64[Tensor, " R1"]
    """R + 1 offsets of the rows' entries."""
    column: Int64[Tensor, " E"]
    weight: Float[Tensor, " E"]
    width: int
    """Number of columns."""
    is_identity: bool = False
    has_own_columns: bool = False
    """Whether entry e is in column e, so that composing is a gather of the other map's rows."""
    is_whole: bool = False
    """Whether each row adds up to 1 or is empty."""

    @staticmethod
    def identity(count: int, device: torch.device | str = "cpu") -> SparseMap:
        """Make the map that changes nothing."""
        rows = torch.arange(count + 1, device=device)
        return SparseMap(rows, rows[:-1], torch.ones(count, device=device), count, is_identity=True, is_whole=True)

    @staticmethod
    def empty(height: int, width: int = 0, device: torch.device | str = "cpu") -> SparseMap:
        """Make a map without entries."""
        none = torch.zeros(0, dtype=torch.int64, device=device)
        return SparseMap(none.new_zeros(height + 1), none, none.float(), width)

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

    def apply(self, values: Float[Tensor, "C K"]) -> Float[Tensor, "R K"]:
        """See `LinearMap`."""
        if not use_loops(values.device):
            return self.matrix @ values
        result = values.new_empty(self.height, values.shape[1])
        _apply(*self.arrays, values.contiguous().numpy(), result.numpy())
        return result

    def adjoint(self, upstream: Float[Tensor, "R K"]) -> Float[Tensor, "C K"]:
        """See `LinearMap`."""
        if not use_loops(upstream.device):
            return self.transposed.matrix @ upstream
        result = upstream.new_zeros(self.width, upstream.shape[1])
        _add_adjoint(*self.arrays, upstream.contiguous().numpy(), result.numpy())
        return result

    def __matmul__(self, other: SparseMap) -> SparseMap:
        """Compose two maps, this one after the other.

        Entries of one place are summed and columns ascend within rows, but where this map `has_own_columns`.
        """
        if other.is_identity:
            return self
        if self.has_own_columns:
            weight = other.weight * self.weight.index_select(0, other.row)
            return SparseMap(other.crow.index_select(0, self.crow), other.column, weight, other.width)
        if self.crow.device.type == "cpu":
            return SparseMap.from_scipy(self.to_scipy() @ other.to_scipy())
        product = torch.sparse.mm(self.matrix, other.matrix)
        return SparseMap(product.crow_indices(), product.col_indices(), product.values(), other.width)

    def row_sums(self) -> Float[Tensor, " R"]:
        """Sum the weights of each row."""
        if self.is_whole:
            return (self.crow.diff() > 0).to(self.weight.dtype)
        return self.apply(self.weight.new_ones(self.width, 1))[:, 0]

    def to(self, device: torch.device | str, dtype: torch.dtype | None = None) -> SparseMap:
        """Copy the map to a device, its weights to a type."""
        weight = self.weight.to(device, dtype or self.weight.dtype)
        return replace(self, crow=self.crow.to(device), column=self.column.to(device), weight=weight)

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


@loop
def _apply(crow, column, weight, values, result):
    for row in range(len(crow) - 1):
        for k in range(values.shape[1]):
            result[row, k] = 0
        for entry in range(crow[row], crow[row + 1]):
            for k in range(values.shape[1]):
                result[row, k] += weight[entry] * values[column[entry], k]


@loop
def _add_adjoint(crow, column, weight, upstream, result):
    for row in range(len(crow) - 1):
        for entry in range(crow[row], crow[row + 1]):
            for k in range(upstream.shape[1]):
                result[column[entry], k] += weight[entry] * upstream[row, k]


def offsets(rows: Int64[Tensor, " E"], count: int) -> Int64[Tensor, " R1"]:
    """Count row offsets [count + 1] of entries that lie in these rows."""
    result = rows.new_zeros(count + 1)
    result[1:] = torch.bincount(rows, minlength=count).cumsum(0)
    return result
