"""Everything that decides how a cloak is evaluated, in one dataclass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.attack.settings import check_settings
from cloak_core.attack.settings.values import Bounds
from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.controls import STANDARD
from cloak_core.evaluation.intervals import RESAMPLES
from cloak_core.files.errors import InputError
from cloak_core.render.settings import RenderOptions
from cloak_core.scene.cameras import Camera


@dataclass(frozen=True, kw_only=True)
class EvaluateSettings(RenderOptions):
    """How to evaluate. The defaults are the paper's camera and threshold."""

    images_per_view: Annotated[int, Bounds(1)] = 4
    """Images (background, shift, outfit) of every body at every angle, elevation and distance."""
    most_images: Annotated[int | None, Bounds(1)] = None
    """Where these are more, only so many of them, drawn by the seed."""
    distances: tuple[float, ...] = (2.2,)
    """Camera distances, metres."""
    elevation: Annotated[float, Bounds(-90, 90)] = 6.0
    """Camera elevation, degrees."""
    elevations: tuple[float, ...] = ()
    """Several elevations instead, degrees: every body is seen from each at every angle and distance."""
    field_of_view: Annotated[float, Bounds(0, 180, "()")] = 60.0
    """Vertical field of view, degrees."""
    size: Annotated[int, Bounds(16, 4096)] = 416
    """Width and height of the images, pixels."""
    cycles: Literal["matching", "studio", "sky"] | None = None
    """Bodies as Blender's Cycles renders them in this light (needs bpy): our model's own, lamps in a room, or sun and
    sky. In their first outfit, from one distance and elevation; into RUN/evaluation-LIGHT."""
    shift: Annotated[int, Bounds()] = 50
    """The body is moved by up to this many pixels along both axes, as in training; 0 keeps it in the middle."""
    threshold: Annotated[float, Bounds(0, 1, "()")] = THRESHOLD
    """A person counts as detected above this score."""
    controls: tuple[Literal["clothing", "grey", "random", "stripes", "checks"], ...] = STANDARD
    """What the logo is compared with."""
    bare: Annotated[int, Bounds(1)] = 256
    """At most this many bare backgrounds are looked at for false alarms."""
    resamples: Annotated[int, Bounds(100)] = RESAMPLES
    """Bootstrap resamples behind each interval."""
    batch: Annotated[int, Bounds(1)] = 16
    """Images the detectors see at once."""
    seed: Annotated[int, Bounds()] = 0
    """Every random draw derives from it: backgrounds, shifts, outfits and the random-colour logo."""

    def __post_init__(self) -> None:
        check_settings(self)
        if 2 * self.shift >= self.size:
            raise InputError(f"--shift: {self.shift} px would move the body out of {self.size} px images")
        if not self.distances or min(self.distances) <= 0:
            raise InputError(f"--distances: {self.distances} are not in front of the camera")
        if any(not -90 <= elevation <= 90 for elevation in self.elevations):
            raise InputError(f"--elevations: {self.elevations} leave [-90, 90] degrees")
        if self.cycles and (len(self.distances) > 1 or len(self.elevations) > 1):
            raise InputError("--cycles: from one distance and one elevation; frames are rendered by azimuth alone")

    @property
    def camera(self) -> Camera:
        """The camera, but for azimuth and distance (and the elevation, where there are several)."""
        return Camera(elevation=self.elevation, field_of_view=self.field_of_view, width=self.size, height=self.size)
