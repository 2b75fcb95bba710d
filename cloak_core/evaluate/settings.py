"""Everything that decides how a cloak is evaluated, in one dataclass."""

from __future__ import annotations

from dataclasses import dataclass

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluate.controls import NATURAL, STANDARD
from cloak_core.evaluate.intervals import RESAMPLES
from cloak_core.files.errors import InputError
from cloak_core.scene.cameras import Camera


@dataclass(frozen=True, kw_only=True)
class EvaluateSettings:
    """How to evaluate. The defaults are the paper's camera and threshold."""

    images_per_view: int = 4
    """Images (background, shift, outfit) of every body at every angle and distance."""
    distances: tuple[float, ...] = (2.2,)
    """Camera distances, metres."""
    elevation: float = 6.0
    """Camera elevation, degrees."""
    field_of_view: float = 60.0
    """Vertical field of view, degrees."""
    size: int = 416
    """Width and height of the images, pixels."""
    samples: int | None = None
    """Samples per pixel (1, 4, 16, 64); None takes the renderer's default."""
    shift: int = 50
    """The body is moved by up to this many pixels along both axes, as in training; 0 keeps it in the middle."""
    threshold: float = THRESHOLD
    """A person counts as detected above this score."""
    controls: tuple[str, ...] = STANDARD
    """What the logo is compared with: clothing, grey, random, stripes, checks."""
    bare: int = 256
    """At most this many bare backgrounds are looked at for false alarms."""
    resamples: int = RESAMPLES
    """Bootstrap resamples behind each interval."""
    batch: int = 16
    """Images the detectors see at once."""
    seed: int = 0
    """Decides backgrounds, shifts, outfits and the random-colour logo."""

    def __post_init__(self) -> None:
        at_least = {"images_per_view": 1, "size": 16, "shift": 0, "bare": 1, "resamples": 100, "batch": 1, "seed": 0}
        for name, low in at_least.items():
            if getattr(self, name) < low:
                raise InputError(f"--{name.replace('_', '-')}: {getattr(self, name)} is less than {low}")
        if not 0 < self.threshold < 1:
            raise InputError(f"--threshold: {self.threshold} is not in (0, 1)")
        if 2 * self.shift >= self.size:
            raise InputError(f"--shift: {self.shift} px would move the body out of {self.size} px images")
        if not self.distances or min(self.distances) <= 0:
            raise InputError(f"--distances: {self.distances} are not in front of the camera")
        unknown = set(self.controls) - {*STANDARD, *NATURAL}
        if unknown:
            raise InputError(f"--controls: {sorted(unknown)[0]!r} is no control")

    @property
    def camera(self) -> Camera:
        """The camera, but for azimuth and distance."""
        return Camera(elevation=self.elevation, field_of_view=self.field_of_view, width=self.size, height=self.size)
