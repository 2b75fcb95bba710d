"""Everything that decides how a logo is trained, in one dataclass, with three presets.

`paper` is the paper's text, `reference` its published code, `best` what this project measured to work best. Every
field is checked by name when a `TrainSettings` is made; bad values raise `InputError` naming the option.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Mapping
from dataclasses import dataclass

from cloak_core.attack.limits import BOUNDS, CHOICES
from cloak_core.attack.parsing import check_bounds, convert, option, parse_azimuths, parse_range, parse_weights
from cloak_core.files.errors import InputError


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """How to train. The defaults are preset `paper`; `make_settings` starts from any preset."""

    preset: str = "paper"
    """Where the settings come from: paper, reference or best."""

    # --- length
    epochs: float | None = 100.0
    """Passes over the data; an epoch shows every background once at every training angle. None when `steps` counts."""
    steps: int | None = None
    """Updates of the colours, instead of `epochs`."""
    batch: int = 8
    """Images per update."""
    max_seconds: float | None = None
    """Stop in order (checkpoint written, resumable) after this much training time, seconds."""
    held_out: float = 0.0
    """Share of the training poses and backgrounds that is set aside; the colours that do best on it are kept."""
    held_out_every: int = 50
    """Steps between measurements on what is held out."""
    patience: int = 0
    """End after so many measurements in a row without a better one; 0 trains to the end."""

    # --- views
    angles: str = "-10:10:5"
    """Training azimuths in degrees: "0", "-10,0,10", FIRST:LAST:STEP (last included), or LOW..HIGH for any angle in
    between, dealt evenly ten degrees by ten degrees; 0..360 is the full circle."""
    angle_jitter: float = 0.0
    """Each azimuth is moved by up to this many degrees, uniformly; 0 keeps the angles and lets views be reused."""
    hard_views: float = 0.0
    """Share of the images whose pose and azimuth are drawn by how surely the detectors still find a person there; the
    others are dealt evenly."""
    elevation: str = "6"
    """Camera elevation in degrees: one number, or LOW:HIGH for a uniform draw per image."""
    elevation_jitter: float = 0.0
    """Standard deviation of the elevation, degrees."""
    distance: str = "2.2"
    """Camera distance in metres: one number, or LOW:HIGH for a uniform draw per image."""
    field_of_view: float = 60.0
    """Vertical field of view, degrees."""
    size: int = 416
    """Width and height of the rendered images, pixels."""
    samples: int | None = None
    """Samples per pixel: 1, 4, 16 or 64; None takes the renderer's default, 4 where every image has its own camera."""
    outfits: str = "random"
    """Clothing of the body outside the logo: "random" (a draw per image) or "first"."""

    # --- augmentation
    translation: int = 50
    """The body is moved by up to this many pixels along both axes."""
    translation_per: str = "image"
    """One translation per "image" or per "batch"."""
    contrast: str = "0:1"
    """LOW:HIGH of the factor on the colours; "1" switches it off."""
    brightness: str = "0:1"
    """LOW:HIGH of what is added to the colours; "0" switches it off."""
    noise: float = 0.1
    """Amplitude of the uniform noise on the colours."""
    photometric_on: str = "logo"
    """Contrast, brightness and noise act on the "logo" (per face) or on the "render" (per pixel of the body)."""
    occluders: int = 0
    """Up to so many rectangles, cut from other backgrounds, stand before each body."""
    zoom: str = "1"
    """LOW:HIGH of the factor by which the finished image is enlarged about its centre; "1" switches it off."""
    blur: float = 0.0
    """The finished image is blurred by a Gaussian of up to this standard deviation, pixels; 0 switches it off."""
    jpeg: str | None = None
    """LOW:HIGH of the JPEG quality (1..100) that the finished image goes through; None switches it off."""

    # --- loss
    loss: str = "score"
    """Of each image's boxes: "score" (person score), "objectness" (of boxes whose likeliest class is person), "log"
    (-log(1 - score), which keeps its gradient where the score saturates)."""
    reduce: str = "max"
    """From an image's boxes to one number: "max", "topk" (mean of the ten best) or "logsumexp" (soft maximum)."""
    rpn_weight: float = 0.0
    """Two-stage detectors: weight of the objectness that their first stage gives the proposals behind person boxes;
    what lowers it kills the proposal itself."""
    ensemble: str = "mean"
    """Of several detectors' losses for an image: "mean", "max" (the detector that sees most) or "weighted"."""
    detector_weights: str | None = None
    """For ensemble "weighted": one weight for each detector, A,B,C; only their ratios count."""
    detectors_per_step: int | None = None
    """Ask only so many of the detectors in each step, drawn anew; None asks all."""
    tv_weight: float = 2.5
    """Weight of total variation (sum over inner edges of metres x colour difference, divided by the logo's faces)."""

    nps_weight: float = 0.0
    """Weight of non-printability: the mean distance of the colours to the nearest one of `palette`."""
    palette: str | None = None
    """Palette file of what can be printed: a colour a line, three numbers in [0, 1] or #rrggbb; or a GIMP .gpl."""

    # --- optimiser
    optimizer: str = "sgd"
    """"sgd" or "adam"."""
    lr: float = 0.1
    """Learning rate, in units of colour [0, 1]."""
    momentum: float = 0.0
    """Of SGD, [0, 1)."""
    schedule: str = "step"
    """Learning rate over time: "constant", "step" (times 0.1 every `lr_epochs` epochs), "cosine" (ends at 1 %)."""
    lr_epochs: float = 10.0
    """Epochs between the drops of schedule "step"."""
    gamut: str = "projection"
    """Colours stay in [0, 1] by "projection" after every update, or as the "sigmoid" of free parameters."""
    initial: str = "grey"
    """First colours: "grey", "random" (uniform per face and channel) or "clothing" (the first outfit's own)."""
    init: str | None = None
    """Go on from these colours instead: a run folder of the same logo, or colours [L, 3] (`cloak logo transfer`)."""

    # --- the run
    seed: int = 0
    """Every random draw derives from it."""
    threads: int | None = None
    """CPU threads of torch; None leaves them as they are. Bit-identical results need equal numbers."""
    microbatch: int | None = None
    """Images that a detector sees at a time, which bounds its memory; None shows it the whole batch. The gradient is
    that of the whole batch either way, but for rounding."""
    device: str = "cpu"
    """torch device: "cpu", "cuda", "cuda:1"."""
    threshold: float = 0.6
    """A person counts as detected above this score (only for the success that events tell)."""
    checkpoint_every: int = 100
    """Steps between checkpoints; 0 writes one at the end alone."""
    preview_every: int = 100
    """Steps between preview pictures; 0 writes none."""

    def __post_init__(self) -> None:
        for name, (low, high, ends) in BOUNDS.items():
            check_bounds(name, getattr(self, name), low, high, ends)
        for name, known in CHOICES.items():
            if getattr(self, name) not in known:
                allowed = ", ".join(str(k) for k in known if k is not None)
                raise InputError(f"{option(name)}: {getattr(self, name)!r} is not one of {allowed}")
        if (self.epochs is None) == (self.steps is None):
            raise InputError("--steps and --epochs: give one of them")
        self._check_ranges()
        if self.patience and not self.held_out:
            raise InputError("--patience: needs a share to be set aside, --held-out 0.2 for instance")
        if self.nps_weight and self.palette is None:
            raise InputError("--nps-weight: needs a --palette to measure against")
        if self.optimizer == "adam" and self.momentum:
            raise InputError("--momentum: Adam has its own, give it with --optimizer sgd")
        if (self.ensemble == "weighted") != (self.detector_weights is not None):
            raise InputError("--ensemble weighted and --detector-weights: one needs the other")
        if self.detector_weights is not None:
            parse_weights(self.detector_weights, "--detector-weights")
        if 2 * self.translation >= self.size:
            raise InputError(f"--translation: {self.translation} px would move the body out of {self.size} px images")

    def _check_ranges(self) -> None:
        parse_azimuths(self.angles, "--angles")
        if parse_range(self.distance, "--distance")[0] <= 0:
            raise InputError(f"--distance: {self.distance} is not in front of the camera")
        if parse_range(self.contrast, "--contrast")[0] < 0:
            raise InputError(f"--contrast: {self.contrast} is negative")
        parse_range(self.brightness, "--brightness")
        low, high = parse_range(self.elevation, "--elevation")
        if low < -90 or high > 90:
            raise InputError(f"--elevation: {self.elevation} is not in [-90, 90]")
        if not -90 <= low - 4 * self.elevation_jitter <= high + 4 * self.elevation_jitter <= 90:
            raise InputError("--elevation-jitter: would carry the camera over the pole")
        low, high = parse_range(self.zoom, "--zoom")
        if low < 0.25 or high > 4:
            raise InputError(f"--zoom: {self.zoom} is not in [0.25, 4]")
        low, high = parse_range(self.jpeg or "50", "--jpeg")
        if low < 1 or high > 100:
            raise InputError(f"--jpeg: {self.jpeg} is not in [1, 100]")

    def epoch_images(self, background_count: int) -> int:
        """Images in one epoch: every background at every training angle, or in every ten degrees of a range."""
        return background_count * len(parse_azimuths(self.angles).starts)

    def total_steps(self, background_count: int) -> int:
        """Updates of the whole run; the last one may hold fewer images than a batch."""
        if self.steps is not None:
            return self.steps
        return max(1, math.ceil(self.epochs * self.epoch_images(background_count) / self.batch))


PRESETS: dict[str, dict[str, object]] = {
    "paper": {},
    "reference": {
        "elevation_jitter": 0.09,
        "translation": 25,
        "translation_per": "batch",
        "contrast": "0.8:1.2",
        "brightness": "-0.1:0.1",
        "loss": "objectness",
        "lr": 1e-2 / math.sqrt(8),
        "momentum": 0.9,
        "schedule": "constant",
    },
    "best": {
        "epochs": None,
        "steps": 600,
        "contrast": "0.8:1.2",
        "brightness": "-0.1:0.1",
        "optimizer": "adam",
        "lr": 0.05,
        "schedule": "cosine",
    },
}
"""What each preset changes of the defaults. The reference's learning rate is its 1e-2 / sqrt(batch) at batch 8."""


def make_settings(preset: object = "best", **changes: object) -> TrainSettings:
    """Settings of a preset with changes by name, in the right types (7 becomes 7.0 where a number is meant).

    `steps` replaces the preset's `epochs` and the other way round. Unknown names, wrong types and bad values raise
    `InputError` naming the option.
    """
    if not isinstance(preset, str) or preset not in PRESETS:
        raise InputError(f"--preset: {preset!r} is not one of {', '.join(PRESETS)}")
    values = dict(PRESETS[preset])
    if changes.get("steps") is not None and changes.get("epochs") is None:
        values["epochs"] = None
    elif changes.get("epochs") is not None and changes.get("steps") is None:
        values["steps"] = None
    return settings_from_record(values | {"preset": preset} | changes)


def settings_from_record(record: Mapping[str, object]) -> TrainSettings:
    """Settings from plain values as JSON, TOML or flags give them; names that are missing keep the default."""
    types = typing.get_type_hints(TrainSettings)
    unknown = sorted(set(record) - set(types))
    if unknown:
        raise InputError(f"{option(unknown[0])}: no such setting (known: {', '.join(types)})")
    return TrainSettings(**{name: convert(name, value, types[name]) for name, value in record.items()})


def settings_record(settings: TrainSettings) -> dict[str, object]:
    """Settings as plain values for JSON; `settings_from_record` reads them back."""
    return dataclasses.asdict(settings)
