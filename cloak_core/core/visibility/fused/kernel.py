"""Compile Triton kernels."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import torch
import triton
import triton.language as tl

NO_FUSION = {"enable_fp_fusion": False}
"""Fused multiply-adds round once instead of twice: other bits than everywhere else."""


def kernel(*numbers: str) -> Callable[[Callable], object]:
    """Decorate a kernel, or a function of one; it is not compiled anew for other values of these numbers."""
    # Under pytest, functions come wrapped in a check of types, which cannot be compiled.
    return lambda function: triton.jit(inspect.unwrap(function), do_not_specialize=numbers)


@kernel()
def _one(out):
    tl.store(out, 1)


def try_out(device: torch.device) -> None:
    """Start a kernel on a device. Raises whatever Triton raises where it cannot."""
    _one[(1,)](torch.zeros(1, dtype=torch.int64, device=device), **NO_FUSION)
