"""Everything that decides how cloaks are evaluated, filmed, worn and judged in photographs, and kept: a dataclass each.

Free of torch: the command line reads them when it starts.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from tyro.conf import Suppress, UseAppendAction

from cloak_core.core.cameras import Camera
from cloak_core.core.detector import IOU, THRESHOLD
from cloak_core.core.evaluation import NAMES, STANDARD
from cloak_core.core.evaluation.intervals import RESAMPLES
from cloak_core.core.settings import Preset, check_settings
from cloak_core.core.settings.values import Angles, Bounds, Positive
from cloak_core.core.visibility.settings import RenderOptions
from cloak_core.files.errors import InputError

T = TypeVar("T")
Internal = Annotated[T, Suppress]
"""Set by programs, not an option of a command."""


@dataclass(frozen=True, kw_only=True)
class EvaluateSettings(RenderOptions):
    """How to evaluate. The defaults are the paper's camera and threshold."""

    images_per_view: Annotated[int, Bounds(1)] = 4
    """Images of every body at every angle, elevation and distance."""
    most_images: Annotated[int | None, Bounds(1)] = None
    """Most images; fewer are drawn by the seed."""
    distances: tuple[float, ...] = (2.2,)
    """Camera distances, metres."""
    elevation: Annotated[float, Bounds(-90, 90)] = 6.0
    """Camera elevation, degrees."""
    elevations: tuple[float, ...] = ()
    """Camera elevations, degrees, instead of one."""
    field_of_view: Annotated[float, Bounds(0, 180, "()")] = 60.0
    """Vertical field of view, degrees."""
    size: Annotated[int, Bounds(16, 4096)] = 416
    """Width and height of the images, pixels."""
    cycles: Literal["matching", "studio", "sky"] | None = None
    """Render by Blender's Cycles (needs bpy) in our light, a room's or the sky's, into RUN/evaluation-LIGHT."""
    shift: Annotated[int, Bounds()] = 50
    """Move the body by up to this many pixels along both axes."""
    threshold: Annotated[float, Bounds(0, 1, "()")] = THRESHOLD
    """Score above which a person counts as detected."""
    controls: tuple[Literal[NAMES], ...] = STANDARD
    """What the logo is compared with; resampled: own clothes."""
    bare: Annotated[int, Bounds(1)] = 256
    """Backgrounds without people to count false alarms on, at most."""
    resamples: Annotated[int, Bounds(100)] = RESAMPLES
    """Bootstrap resamples behind each interval."""
    batch: Annotated[int, Bounds(1)] = 16
    """Images that detectors see at once."""
    seed: Annotated[int, Bounds()] = 0
    """Seed of every random draw."""

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


MOST_FRAMES = 20_000
"""Of a film, in all takes."""


@dataclass(frozen=True, kw_only=True)
class FilmSettings(RenderOptions):
    """How to film. The defaults are the paper's camera and threshold."""

    camera: str = "still"
    """still, orbit, approach, or FILE.csv of keyframes: time, azimuth, elevation, distance."""
    angles: Angles = Angles((0.0,))
    """Azimuths where takes begin, degrees: A:B:STEP or a comma list; the first is shown, all are counted."""
    elevation: Annotated[float, Bounds(-90, 90)] = 6.0
    """Camera elevation, degrees."""
    distance: Positive = 2.2
    """Camera distance, metres."""
    far: Positive = 12.0
    """Where an approach begins, metres."""
    near: Positive = 1.5
    """Where it ends, metres."""
    turns: float = 1.0
    """Turns of an orbit; below 0 the other way."""
    follow: bool = False
    """Look at the middle of each pose, not of the whole motion."""
    field_of_view: Annotated[float, Bounds(0, 180, "()")] = 60.0
    """Vertical field of view, degrees."""
    size: Annotated[int, Bounds(16, 2048)] = 416
    """Width and height of the images, pixels."""
    fps: Annotated[float, Bounds(0.1, 240)] = 25.0
    """Frames a second."""
    poses_per_second: Positive | None = None
    """Poses a second (default: one a frame; single poses are held for a second)."""
    seconds: Positive | None = None
    """Length of a take (default: once through poses or keyframes; 4 s at least with a moving camera)."""
    outfit: Annotated[int, Bounds()] = 0
    """Outfit of the scene that is own clothing; further takes wear the next."""
    threshold: Annotated[float, Bounds(0, 1, "()")] = THRESHOLD
    """Score above which a person counts as detected."""
    track: bool = False
    """Draw the numbers of the tracks of a plain IoU tracker."""
    track_hits: Annotated[int, Bounds(1)] = 3
    """Frames in a row that confirm a track."""
    track_misses: Annotated[int, Bounds()] = 5
    """Frames in a row that a confirmed track outlives."""
    track_iou: Annotated[float, Bounds(0, 1, "()")] = 0.3
    """Overlap from which a box goes on with a track."""
    batch: Annotated[int, Bounds(1)] = 8
    """Images that detectors see at once."""

    def __post_init__(self) -> None:
        check_settings(self)
        if self.camera == "approach" and self.near >= self.far:
            raise InputError(f"--near: {self.near:g} m is not nearer than --far {self.far:g} m")


@dataclass(frozen=True, kw_only=True)
class JudgeSettings:
    """How to judge photographs."""

    threshold: Annotated[float, Bounds(0, 1, "()")] = THRESHOLD
    """Score above which a person counts as detected."""
    iou: Annotated[float, Bounds(0, 1, "(]")] = IOU
    """Overlap from which a detected box is the person's (--boxes)."""
    every: Annotated[int, Bounds(1)] = 10
    """Take every N-th frame of a video."""
    most_frames: Annotated[int, Bounds(1)] = 50
    """Most frames of a video, from its beginning."""
    longest: Annotated[int, Bounds(32, 8192)] = 1280
    """Reduce larger pictures to this many pixels on their longer side."""
    resamples: Annotated[int, Bounds(100)] = RESAMPLES
    """Bootstrap resamples behind each interval."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, kw_only=True)
class WearSettings:
    """How people in photographs are dressed and judged."""

    context: Annotated[float, Bounds(1, 8)] = 1.25
    """Side of each image, in heights of the person's box."""
    size: Annotated[int, Bounds(64, 4096)] = 416
    """Width and height of the images, pixels."""
    threshold: Annotated[float, Bounds(0, 1, "()")] = 0.6
    """Score above which a person counts as detected."""
    bare: Annotated[int, Bounds(0, 1024)] = 16
    """Backgrounds without people to count false alarms on, at most."""
    batch: Annotated[int, Bounds(1, 1024)] = 8
    """Images that detectors see at once."""
    seed: Internal[int] = 0
    """Every random draw derives from it."""
    resamples: Internal[int] = RESAMPLES
    """Bootstrap resamples behind each interval."""


QUICK_STEPS = 150


@dataclass(frozen=True, kw_only=True)
class StoreOptions:
    """How much is trained and evaluated, and where results are kept."""

    out: Path = Path("runs/reproduce")
    """Folder for all results; what is there is not done again."""
    quick: bool = False
    """Fewer steps, angles, images and seeds: all within 90 minutes on two cores."""
    preset: Preset = "best"
    """Training preset."""
    steps: UseAppendAction[tuple[int, ...]] = ()
    """Updates of the colours, once or for each --detector (default: 150 with --quick, else the preset's)."""
    seeds: int | None = None
    """Repetitions, each with another seed (default: 1 with --quick, else 3)."""
    seed: int = 0
    """Seed of every random draw."""
    batch: Internal[int | None] = None
    """Images per update; None: what the preset says."""
    images_per_view: Internal[int | None] = None
    """Test images per body and angle; None: 2 when quick, else 8."""
    size: Internal[int] = 416
    """Width and height of the images, pixels."""
    samples: Internal[int | None] = None
    """Samples per pixel; None takes the renderer's default."""
    device: Internal[str] = "cpu"
    """Torch device."""
    command: Internal[str] = ""
    """The command line that asked for it, for the record."""

    @property
    def seed_list(self) -> tuple[int, ...]:
        """The seed of each repetition."""
        return tuple(range(self.seed, self.seed + (self.seeds or (1 if self.quick else 3))))

    @property
    def test_images(self) -> int:
        """Test images per body and angle."""
        return self.images_per_view or (2 if self.quick else 8)

    def counts(self) -> dict:
        """Describe the amount for a record: steps, seeds, images per view, quick."""
        length = QUICK_STEPS if self.quick else f"as in preset {self.preset}"
        if self.steps:
            length = self.steps[0] if len(self.steps) == 1 else " / ".join(map(str, self.steps)) + " by detector"
        return {"steps": length, "seeds": len(self.seed_list), "images_per_view": self.test_images, "quick": self.quick}
