"""What decides how views are rendered: the options users see, the light, and the limits of a `ViewCache`."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal

from cloak_core.core.cameras import Number, Vector
from cloak_core.files.errors import InputError

GRIDS = {1: 1, 4: 2, 16: 4, 64: 8}
"""Samples per pixel, and samples along each side of a pixel."""
AREA_GRID = 8
"""Samples along each side of a pixel where coverage is measured by area but samples are asked for."""


@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """Rendering options of the command line. Settings of training, evaluation and film inherit them."""

    samples: Literal[1, 4, 16, 64] | None = None
    """Samples per pixel; None: exact area, or 4 where every image has its own camera."""


@dataclass(frozen=True)
class Light:
    """A point light and the bodies' material (PyTorch3D's defaults). Raises `InputError` unless all is finite."""

    ambient: Number = 0.5
    diffuse: Number = 0.3
    specular: Number = 0.2
    shininess: Number = 64.0
    position: Vector = (0.0, 85.0, 100.0)
    """World coordinates, metres."""
    color: Vector = (1.0, 1.0, 1.0)
    """Scales the three channels of everything lit."""

    def __post_init__(self) -> None:
        values = (self.ambient, self.diffuse, self.specular, self.shininess, *self.position, *self.color)
        if not all(math.isfinite(value) for value in values):
            raise InputError(f"light: {values} are not all finite numbers")


@dataclass(frozen=True, kw_only=True)
class RenderSettings(RenderOptions):
    """Options, light, device and limits of rendering. Raises `InputError` for another number of samples.

    With `samples` None coverage is measured by exact area, the best there is for its time (docs/accuracy.md).
    """

    light: Light = Light()
    device: object = "cpu"
    """A torch device or its name."""
    memory_bytes: int = 2 << 30
    """Budget for views kept in memory."""

    def __post_init__(self) -> None:
        if self.samples is not None and self.samples not in GRIDS:
            raise InputError(f"samples: {self.samples} per pixel; there are {', '.join(map(str, GRIDS))}")

    @staticmethod
    def of(options: RenderOptions, **more: object) -> RenderSettings:
        """Make settings with a user's options; `more` stands for the other fields, or replaces options."""
        return RenderSettings(**{field.name: getattr(options, field.name) for field in fields(RenderOptions)} | more)

    @property
    def by_area(self) -> bool:
        """Whether coverage is measured by exact area."""
        return self.samples is None

    @property
    def grid(self) -> int:
        """Samples along each side of a pixel."""
        return AREA_GRID if self.samples is None else GRIDS[self.samples]
