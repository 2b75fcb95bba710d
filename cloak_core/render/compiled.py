"""Loops for the CPU, compiled by numba on their first call and kept on disk.

torch pays for every operation and every intermediate array; a triangle of a body covers a handful of samples, so on the
CPU that is most of a view's time. The loops do the same arithmetic in the same order (no fused or reordered operations)
and give the same result as the torch operations beside them, which other devices use and tests compare them with.
"""

from __future__ import annotations

import numba
import numpy as np
import torch

loop = numba.njit(cache=True, nogil=True, error_model="numpy")
"""Decorator of functions of arrays and numbers; they release the interpreter, so that threads run them side by side."""


def arrays(*tensors: torch.Tensor) -> list[np.ndarray]:
    """The tensors' own memory, contiguous, as loops want it."""
    return [tensor.detach().contiguous().numpy() for tensor in tensors]
