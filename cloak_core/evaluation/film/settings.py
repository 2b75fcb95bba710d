"""Everything that decides how a film is made, in one dataclass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cloak_core.attack.settings import check_settings
from cloak_core.attack.settings.values import Angles, Bounds, Positive
from cloak_core.detectors import THRESHOLD
from cloak_core.files.errors import InputError
from cloak_core.render.settings import RenderOptions

MOST_FRAMES = 20_000


@dataclass(frozen=True)
class Rule:
    """When boxes make a track."""

    hits: int = 3
    """Frames in a row that confirm a track; one miss before that ends it."""
    misses: int = 5
    """Frames in a row without a box that a confirmed track outlives."""
    iou: float = 0.3
    """Least overlap of a box with the track's last one."""


@dataclass(frozen=True, kw_only=True)
class FilmSettings(RenderOptions):
    """How to film. The defaults are the paper's camera and threshold."""

    camera: str = "still"
    """still, orbit (--turns around), approach (from --far to --near), or FILE.csv of keyframes: time in seconds, and
    azimuth, elevation (degrees), distance (metres) as far as they move; linear in between."""
    angles: Angles = Angles((0.0,))
    """Azimuths at which a take begins, in degrees: A:B:STEP or a comma list. Of several takes the first is the film;
    all are counted."""
    elevation: Annotated[float, Bounds(-90, 90)] = 6.0
    """Camera elevation, degrees."""
    distance: Positive = 2.2
    """Camera distance, metres."""
    far: Positive = 12.0
    """Where an approach begins, metres."""
    near: Positive = 1.5
    """Where it ends, metres."""
    turns: float = 1.0
    """How often an orbit goes around; below 0 the other way."""
    follow: bool = False
    """The camera looks at the middle of each pose, for people who walk away (default: at that of the whole motion)."""
    field_of_view: Annotated[float, Bounds(0, 180, "()")] = 60.0
    """Vertical field of view, degrees."""
    size: Annotated[int, Bounds(16, 2048)] = 416
    """Width and height of each of the two pictures, pixels."""
    fps: Annotated[float, Bounds(0.1, 240)] = 25.0
    """Frames of the film a second."""
    poses_per_second: Positive | None = None
    """Poses of the scene a second (default: one a frame of a motion; single poses are held for a second each)."""
    seconds: Positive | None = None
    """Length of a take (default: once through the poses or the keyframes; a moving camera takes at least 4 s)."""
    outfit: Annotated[int, Bounds()] = 0
    """Which of the scene's outfits is the own clothing; further takes wear the next ones."""
    threshold: Annotated[float, Bounds(0, 1, "()")] = THRESHOLD
    """A person counts as detected above this score."""
    track: bool = False
    """Draw the numbers of the tracks that a plain IoU tracker confirms; they are counted in any case."""
    track_hits: Annotated[int, Bounds(1)] = 3
    """Frames in a row that confirm a track."""
    track_misses: Annotated[int, Bounds()] = 5
    """Frames in a row without it that a confirmed track outlives."""
    track_iou: Annotated[float, Bounds(0, 1, "()")] = 0.3
    """Overlap from which a box goes on with a track."""
    batch: Annotated[int, Bounds(1)] = 8
    """Images the detectors see at once."""

    def __post_init__(self) -> None:
        check_settings(self)
        if self.camera == "approach" and self.near >= self.far:
            raise InputError(f"--near: {self.near:g} m is not nearer than --far {self.far:g} m")

    @property
    def rule(self) -> Rule:
        """The tracker's rule."""
        return Rule(self.track_hits, self.track_misses, self.track_iou)
