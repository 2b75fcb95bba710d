"""Settings of `attack.sampling`: which bodies, cameras and clothes an image shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.attack.settings.values import Angles, Azimuths, Bounds, Range
from cloak_core.files.errors import InputError
from cloak_core.render.settings import RenderOptions
from cloak_core.scene.cameras import Camera


@dataclass(frozen=True, kw_only=True)
class ViewSettings(RenderOptions):
    """What the rendered images show of the body."""

    angles: Azimuths = Azimuths(Angles((-10.0, -5.0, 0.0, 5.0, 10.0)))
    """Azimuths of the camera, degrees: 0; -10,0,10; FIRST:LAST:STEP with LAST included; or LOW..HIGH for any angle in
    between, drawn evenly from sectors of ten degrees. 0..360 is the full circle."""
    angle_jitter: Annotated[float, Bounds(0, 180)] = 0.0
    """Change each azimuth by up to this many degrees, uniformly; 0 keeps the azimuths, so that views can be reused."""
    hard_views: Annotated[float, Bounds(0, 1)] = 0.0
    """Share of the images that show poses and azimuths where detectors still find the person; the others are drawn
    evenly."""
    elevation: Annotated[Range, Bounds(-90, 90)] = Range(6.0, 6.0)
    """Camera elevation, degrees: one number, or LOW:HIGH for a uniform draw per image."""
    elevation_jitter: Annotated[float, Bounds(0, 22.5)] = 0.0
    """Standard deviation of the elevation, degrees."""
    distance: Annotated[Range, Bounds(ends="()")] = Range(2.2, 2.2)
    """Camera distance, metres: one number, or LOW:HIGH for a uniform draw per image."""
    field_of_view: Annotated[float, Bounds(0, 180, "()")] = 60.0
    """Vertical field of view, degrees."""
    size: Annotated[int, Bounds(16, 4096)] = 416
    """Width and height of the rendered images, pixels."""
    outfits: Literal["random", "first"] = "random"
    """Clothing of the body outside the logo: a random outfit per image, or the first."""

    def camera(self, azimuth: float, elevation: float, distance: float) -> Camera:
        """The camera at a place, degrees and metres."""
        place = {"azimuth": azimuth, "elevation": elevation, "distance": distance}
        return Camera(field_of_view=self.field_of_view, width=self.size, height=self.size, **place)

    def check(self) -> None:
        """InputError: values that do not go together."""
        reach = 4 * self.elevation_jitter
        if not -90 <= self.elevation.low - reach <= self.elevation.high + reach <= 90:
            raise InputError("--elevation-jitter: would carry the camera over the pole")
