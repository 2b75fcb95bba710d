"""Perspective cameras on an orbit around a body.

Conventions: metres, right-handed, y up. Azimuth 0 looks at the front (the camera stands on +z); a positive azimuth
walks the camera towards +x, a positive elevation lifts it. Image row 0 is the top row, the centre of pixel (x, y) lies
at (x + 0.5, y + 0.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from cloak_core.files.errors import InputError

MAX_EXTENT = 4096
"""Largest image width and height, pixels."""
NEAR_SHARE = 1 / 64
"""Default near plane, as a share of the camera's distance: what is nearer to the camera is cut away."""

Number = float | int
Vector = tuple[Number, Number, Number]


@dataclass(frozen=True)
class Camera:
    """One camera; angles in degrees, lengths in metres. Hashable, so that it can name a cached view.

    Raises `InputError` for values that make no picture (NaN, distance <= 0, a field of view outside (0, 180), ...).
    """

    distance: Number = 2.2
    """From the pivot, along the optical axis."""
    elevation: Number = 6.0
    azimuth: Number = 0.0
    field_of_view: Number = 60.0
    """Vertical."""
    width: int = 416
    height: int = 416
    pivot: Vector | None = None
    """The point looked at; None: the centre of the pose's bounding box."""
    near: Number | None = None
    """Distance of the near plane from the camera; None: `NEAR_SHARE` of the distance."""

    def __post_init__(self) -> None:
        numbers = {"distance": self.distance, "elevation": self.elevation, "azimuth": self.azimuth}
        numbers["field of view"] = self.field_of_view
        numbers["near plane"] = self.near_plane
        for axis, value in zip("xyz", self.pivot or (), strict=False):
            numbers[f"pivot {axis}"] = value
        for name, value in numbers.items():
            if not math.isfinite(value):
                raise InputError(f"camera {name}: {value} is not a finite number")
        for name in ("distance", "near plane"):
            if numbers[name] <= 0:
                raise InputError(f"camera {name}: {numbers[name]} is not above 0")
        if not 0 < self.field_of_view < 180:
            raise InputError(f"camera field of view: {self.field_of_view} is not between 0 and 180 degrees")
        if not (0 < self.width <= MAX_EXTENT and 0 < self.height <= MAX_EXTENT):
            raise InputError(f"camera image: {self.width} x {self.height} is not within 1 to {MAX_EXTENT} pixels")

    @property
    def near_plane(self) -> Number:
        return self.distance * NEAR_SHARE if self.near is None else self.near

    @property
    def focal(self) -> float:
        """Focal length in pixels, the same along both axes."""
        return self.height / 2 / math.tan(math.radians(self.field_of_view) / 2)

    @property
    def axes(self) -> tuple[Vector, Vector, Vector]:
        """Unit vectors in world coordinates: right, up, and back (from the pivot to the camera)."""
        a, e = math.radians(self.azimuth), math.radians(self.elevation)
        right = (math.cos(a), 0.0, -math.sin(a))
        up = (-math.sin(e) * math.sin(a), math.cos(e), -math.sin(e) * math.cos(a))
        back = (math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a))
        return right, up, back

    def position(self, pivot: Vector) -> Vector:
        """Locate the camera, given the pivot in use."""
        back = self.axes[2]
        return tuple(p + self.distance * b for p, b in zip(pivot, back, strict=True))
