"""The settings of training's components, with their ranges and their help.

Every field is an option of `cloak train` by its name; the string below it is its help.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.core.cameras import Camera
from cloak_core.core.prints import PRINTS
from cloak_core.core.settings.values import Angles, Azimuths, Bounds, NotNegative, Positive, Range
from cloak_core.core.visibility.settings import RenderOptions
from cloak_core.files.errors import InputError


@dataclass(frozen=True, kw_only=True)
class ComputeSettings:
    """Where to compute."""

    # A command prepares its process by them (`commands.options`); functions leave the process as it is.

    device: str = "cpu"
    """Torch device: auto (CUDA where it works, else CPU), cpu, cuda, cuda:1."""
    threads: Annotated[int | None, Bounds(1, 4096)] = None
    """CPU threads of torch; equal bits need equal numbers."""


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """How long the run is, and what it keeps."""

    epochs: Annotated[float | None, Bounds(ends="()")] = 100.0
    """Passes over the data, instead of --steps: every background once at every training angle."""
    steps: Annotated[int | None, Bounds(1, 10_000_000)] = None
    """Updates of the colours, instead of --epochs."""
    batch: Annotated[int, Bounds(1, 4096)] = 8
    """Images per update."""
    microbatch: Annotated[int | None, Bounds(1, 4096)] = None
    """Images that a detector sees at once, to bound memory; None: the batch. Same gradient up to rounding."""
    max_seconds: Annotated[float | None, Bounds(ends="()")] = None
    """Stop after this many seconds of training, with a checkpoint to resume from."""
    seed: Annotated[int, Bounds(0, 2**63 - 1)] = 0
    """Seed of every random draw."""
    checkpoint_every: Annotated[int, Bounds()] = 100
    """Steps between checkpoints; 0: one at the end."""
    preview_every: Annotated[int, Bounds()] = 100
    """Steps between preview pictures; 0: none."""
    snapshot_every: Annotated[int, Bounds()] = 0
    """Steps between the snapshots of `cloak evaluate --over-time`; 0: none."""

    def check(self) -> None:
        """Check that values go together. InputError: they do not."""
        if (self.epochs is None) == (self.steps is None):
            raise InputError("--steps and --epochs: give one of them")


@dataclass(frozen=True, kw_only=True)
class ViewSettings(RenderOptions):
    """What the rendered images show of the body."""

    angles: Azimuths = Azimuths(Angles((-10.0, -5.0, 0.0, 5.0, 10.0)))
    """Azimuths, degrees: 0; -10,0,10; FIRST:LAST:STEP with LAST included; or LOW..HIGH for any between."""
    elevation: Annotated[Range, Bounds(-90, 90)] = Range(6.0, 6.0)
    """Camera elevation, degrees; LOW:HIGH draws one per image."""
    elevation_jitter: Annotated[float, Bounds(0, 22.5)] = 0.0
    """Standard deviation of the elevation, degrees."""
    distance: Annotated[Range, Bounds(ends="()")] = Range(2.2, 2.2)
    """Camera distance, metres; LOW:HIGH draws one per image."""
    size: Annotated[int, Bounds(16, 4096)] = 416
    """Width and height of the images, pixels."""

    def camera(self, azimuth: float, elevation: float, distance: float) -> Camera:
        """Make the camera at a place, degrees and metres."""
        place = {"azimuth": azimuth, "elevation": elevation, "distance": distance}
        return Camera(width=self.size, height=self.size, **place)

    def check(self) -> None:
        """Check that values go together. InputError: they do not."""
        reach = 4 * self.elevation_jitter
        if not -90 <= self.elevation.low - reach <= self.elevation.high + reach <= 90:
            raise InputError("--elevation-jitter: would carry the camera over the pole")


@dataclass(frozen=True, kw_only=True)
class AugmentationSettings:
    """What makes every image another one."""

    translation: Annotated[int, Bounds(0, 4096)] = 50
    """Move the body by up to this many pixels along both axes."""
    translation_per: Literal["image", "batch"] = "image"
    """Draw the translation for each image, or once for the batch."""
    contrast: Annotated[Range, Bounds(ends="[)")] = Range(0.0, 1.0)
    """Range of the factor on the colours; 1: off."""
    brightness: Range = Range(0.0, 1.0)
    """Range of what is added to the colours; 0: off."""
    noise: Annotated[float, Bounds(0, 1)] = 0.1
    """Amplitude of uniform noise on the colours."""
    cutout: Annotated[float, Bounds(0, 1)] = 0.0
    """Paint up to this share of the logo grey in each image, around a face."""
    crop: Annotated[float, Bounds(0, 0.9)] = 0.0
    """Cut away up to this share of width and height, and enlarge the rest."""
    pad: Annotated[float, Bounds(0, 0.9)] = 0.0
    """Shrink into a grey margin of up to this share of the sides; with --crop, one of the two."""
    blur: Annotated[float, Bounds(0, 2)] = 0.0
    """Baseline (EOT, Athalye et al., ICML 2018): Gaussian blur of at most this standard deviation, pixels."""


@dataclass(frozen=True, kw_only=True)
class PeopleSettings:
    """How photographs of people are shown, where there are any (--people)."""

    people_share: Annotated[float, Bounds(0, 1)] = 1.0
    """With --people: share of photographs among the images."""


Loss = Literal["score", "objectness", "log", "margin"]
Hide = Literal["person", "everything"]


@dataclass(frozen=True, kw_only=True)
class LossSettings:
    """What training minimises."""

    hide: Hide = "person"
    """What cloaks hide: the class person, or every class on the body."""
    loss: Loss = "score"
    """Minimised, of an image's surest box: score, of the person; objectness, where person is likeliest; log, -log(1 -
    score); or margin, logits above the detector's own threshold."""
    ensemble: Literal["mean", "adaptive"] = "mean"
    """Losses of several detectors: mean, or adaptive, by how surely each lately found a person."""
    detectors_per_step: Annotated[int | None, Bounds(1, 4096)] = None
    """Detectors to ask in each step, drawn at random (default: all)."""
    tv_weight: NotNegative = 2.5
    """Weight of total variation: inner edges' length (metres) times colour difference, per face."""
    nps_weight: NotNegative = 0.0
    """Weight of non-printability: mean distance of the colours to the nearest of --palette."""
    palette: str | None = None
    """File of printable colours, one a line: three numbers in [0, 1] or #rrggbb; or a GIMP .gpl."""

    def check(self) -> None:
        """Check that values go together. InputError: they do not."""
        if self.nps_weight and self.palette is None:
            raise InputError("--nps-weight: needs a --palette to measure against")


@dataclass(frozen=True, kw_only=True)
class PatternSettings:
    """Which colours there may be, and how finely they may change."""

    pattern: Literal["free", "camouflage", "tile"] = "free"
    """Where colours change: free, at faces; camouflage, at patches of --feature-cm; tile, at squares of --feature-cm in
    a cloth that repeats every --tile-cm."""
    feature_cm: Annotated[float, Bounds(0, 100, "(]")] = 2.0
    """Diameter of the smallest patch along the body, centimetres."""
    tile_cm: Annotated[float, Bounds(0, 1000, "(]")] = 50.0
    """Width and height of the repeating cloth, centimetres."""
    colors_at_most: Annotated[int | None, Bounds(2, 256)] = None
    """End with at most this many colours, of --palette or learnt."""
    near: str | None = None
    """Garment to stay close to: #rrggbb, clothing, camouflage (woodland), FILE.png@tile=METRES, this logo's colours
    (.npy), a run or zoo:NAME; with --pattern, its mean in each square."""
    within: Positive | None = None
    """Largest mean CIEDE2000 from --near; 1 is just visible."""
    profile: str | None = None
    """Profile (`cloak calibrate`): train colours as photographed after printing; `cloak print --profile` writes those
    to send."""

    def check(self) -> None:
        """Check that values go together. InputError: they do not."""
        if (self.near is None) != (self.within is None):
            raise InputError("--near GARMENT and --within DE: one needs the other")
        if self.near is not None and self.profile is not None:
            raise InputError("--near: says how colours are to look, --profile what comes out of a printer; give one")


@dataclass(frozen=True, kw_only=True)
class SurrogateSettings:
    """What makes many of each detector, so that colours do not hang on one network's peculiarities.

    Drawn anew for each image from (seed, step); the detector itself stays as it is.
    """

    shake: Annotated[float, Bounds(0, 1)] = 0.0
    """Baseline (T-SEA's ShakeDrop, Huang et al., CVPR 2023): multiply residual branches by up to 1 ± this."""


@dataclass(frozen=True, kw_only=True)
class OptimizerSettings:
    """How the colours begin and move."""

    optimizer: Literal["sgd", "adam", "mi"] = "sgd"
    """SGD, Adam, or the baseline mi (MI-FGSM, Dong et al., CVPR 2018): sign steps along a momentum."""
    lr: Positive = 0.1
    """Learning rate, in units of colour [0, 1]."""
    momentum: Annotated[float, Bounds(0, 1, "[)")] = 0.0
    """Momentum of sgd and mi."""
    schedule: Literal["constant", "step", "cosine"] = "step"
    """Learning rate: constant, times 0.1 every ten epochs (step), or cosine to 1 %."""
    gamut: Literal["projection", "sigmoid"] = "projection"
    """Keep colours in [0, 1] by projection after every update, or as the sigmoid of free parameters."""
    initial: Literal[("grey", "random", "clothing", "animal", *PRINTS)] = "grey"
    """First colours: grey; random; clothing, the first outfit; animal, a dog's face, against detectors of many classes;
    or a plain print repeated every 25 cm: balls, crowd, ..."""
    init: str | None = None
    """Begin with these colours: a run of the same logo, zoo:NAME, or colours [L, 3] (.npy)."""
    initial_share: Annotated[float, Bounds(0, 1, "[)")] = 0.0
    """Share of the first colours in the result (WiSE-FT, Wortsman et al., CVPR 2022): 0.5 helps a print or --init
    against unseen detectors."""
    octaves: Annotated[int, Bounds(1, 10)] = 1
    """Number of grids whose sum is the colours, each twice as coarse as the one before; needs --gamut sigmoid."""
    smooth: Annotated[int, Bounds(0, 1000)] = 0
    """Rounds of averaging free parameters with neighbouring faces'."""

    def check(self) -> None:
        """Check that values go together. InputError: they do not."""
        if self.optimizer == "adam" and self.momentum:
            raise InputError("--momentum: Adam has its own, give it with --optimizer sgd")
        if self.initial_share and self.initial not in PRINTS and self.init is None:
            hint = f"with --initial {self.initial} give --initial-share 0"
            raise InputError(f"--initial-share: keeps a share of a print or of --init; {hint}")
        if self.octaves > 1 and self.gamut != "sigmoid":
            raise InputError("--octaves: sums of grids leave [0, 1]; give --gamut sigmoid")


@dataclass(frozen=True, kw_only=True)
class QuerySettings:
    """How a detector is asked that gives no gradient."""

    black_box_queries: Annotated[int | None, Bounds(1, 10_000_000)] = None
    """Images in a search by the detectors' answers alone, best begun with --init (default: train by gradients)."""
