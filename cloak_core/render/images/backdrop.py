"""Photographs into the rows of a canvas: bytes to numbers in [0, 1], in one pass over the memory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, UInt8
from torch import Tensor

from cloak_core.render.compiled import arrays, loop
from cloak_core.render.seam import steps


def lay_backdrop(rows: Float32[Tensor, "P 3"], images: Sequence[UInt8[Tensor, "3 H W"]]) -> None:
    """Fill a canvas (see compositing's `blank`) with one background for each of its images, all of one size."""
    start = 0
    for image in images:
        pixels = image.permute(1, 2, 0).reshape(-1, 3)
        own = rows[start : start + len(pixels)]
        steps(rows.device).lay_image(own, pixels)
        start += len(pixels)


def lay_image(own: Float32[Tensor, "P 3"], pixels: UInt8[Tensor, "P 3"]) -> None:
    """One image's bytes as numbers in [0, 1]. Bytes travel; numbers are made where they go."""
    own.copy_(pixels.to(own.device, non_blocking=True)).div_(255)


def lay_image_by_loop(own: Float32[Tensor, "P 3"], pixels: UInt8[Tensor, "P 3"]) -> None:
    """The same on the CPU."""
    _to_numbers(*(array.reshape(-1) for array in arrays(own, pixels)))


@loop
def _to_numbers(numbers: np.ndarray, values: np.ndarray) -> None:
    for i in range(len(values)):
        numbers[i] = np.float32(values[i]) / np.float32(255)
