"""A network's file in its own runtime: what it says of its input and classes, and the network as a module."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloak_core.detectors.onnx_family.layouts import Layout
from cloak_core.detectors.pixels import PixelFormat
from cloak_core.detectors.specs import check_size
from cloak_core.files.errors import InputError


@dataclass(frozen=True, eq=False)
class RuntimeModel:
    """One image's network, ready to run."""

    path: Path
    digest: str
    """SHA-256 of all its files."""
    run: Callable[[np.ndarray], list[np.ndarray]]
    """From one image [1, 3, H, W] (or [1, H, W, 3]), float32, to the outputs, float32."""
    channels_last: bool
    size: tuple[int, int]
    """(height, width) of its input."""
    output_names: tuple[str, ...]
    names: tuple[str, ...] | None = None
    """Of its classes, where the file says."""
    confidence: float | None = None
    """From which score it reports, where the file says."""
    layout: tuple[str, Layout] | None = None
    """How its outputs are read, by a name, where the file itself tells."""
    pixels: PixelFormat | None = None
    """How it wants its pixels, where the file itself tells."""


def image_size(shape: list[int | None], wanted: tuple[int, int] | None, path: Path) -> tuple[bool, tuple[int, int]]:
    """Tell from an input's shape (None: any) whether channels stand last, and (height, width) to run at.

    InputError: no batch of RGB images; fixed to another size than wanted; neither says a size.
    """
    words = [extent or "any" for extent in shape]
    if len(shape) != 4 or 3 not in (shape[1], shape[3]) or shape[0] not in (None, 1):
        raise InputError(f"{path}: its input {words} is not one RGB image")
    channels_last = shape[3] == 3 and shape[1] != 3
    sides = tuple(shape[1:3] if channels_last else shape[2:4])
    if None not in sides:
        if wanted not in (None, sides):
            fixed, other = (f"{h}x{w}" for h, w in (sides, wanted))
            raise InputError(f"{path}: its input is fixed to {fixed}, it cannot run at {other}")
        return channels_last, check_size(sides, path)
    if wanted is None:
        raise InputError(f"{path}: its input {words} has any size; say one, @HEIGHTxWIDTH")
    return channels_last, wanted
