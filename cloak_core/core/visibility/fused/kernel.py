"""Compile Triton kernels."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import triton

NO_FUSION = {"enable_fp_fusion": False}
"""Fused multiply-adds round once instead of twice: other bits than everywhere else."""


def kernel(*numbers: str) -> Callable[[Callable], object]:
    """Decorate a kernel, or a function of one; it is not compiled anew for other values of these numbers."""
    # Under pytest, functions come wrapped in a check of types, which cannot be compiled.
    return lambda function: triton.jit(inspect.unwrap(function), do_not_specialize=numbers)
