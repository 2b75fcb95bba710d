# SPDX-License-Identifier: GPL-3.0-or-later
"""How a cloak is judged: what the panel lets the user set (kept on the scene), and what the trainer's judges found out.

`cloak evaluate` and `cloak wear` give each detector's rates in the same form.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain, groupby
from pathlib import Path

import bpy

from ..blender.blend_paths import absolute
from ..files.errors import InputError
from ..files.reading import read_json
from ..poses.poses import PoseChoice
from ..trainer.program import SAMPLES
from ..trainer.progress import finite
from ..ui import props

UNREADABLE = (InputError, OSError, KeyError, TypeError, ValueError, AttributeError, IndexError)
"""What a record that somebody damaged may raise."""


class CloakJudging(bpy.types.PropertyGroup):
    """How a cloak is judged."""

    bodies: props.choice(
        "Bodies",
        "What to evaluate on",
        (
            "KEPT",
            "Kept Back",
            "Bodies that training never saw, where it ran on Cloak's own people; else the bodies of the training",
        ),
        ("FRAMES", "Frames", "This body in the frames below: choose such as training did not see"),
    )
    frame_start: props.whole("Start", "First frame to evaluate on", 1)
    frame_end: props.whole("End", "Last frame to evaluate on", 12)
    frame_step: props.whole("Step", "Frames from one to the next", 1, min=1)
    backgrounds: props.path(
        "Backgrounds",
        "Folder of photographs without people that training did not see; empty for procedural scenes that "
        "training never sees",
        "DIR_PATH",
    )
    angle: props.whole("Angle Step (°)", "Degrees from one azimuth to the next, all around the body", 15, min=1, max=90)
    images: props.whole(
        "Images",
        "Images of each kind (the cloak, and each control), spread over bodies, angles and backgrounds. "
        "More of them take longer and make the intervals narrower",
        240,
        min=8,
        max=100_000,
    )
    ring: props.switch("Ring", "Draw success by azimuth as a ring around the body's feet", True)

    eye_from: props.choice(
        "From",
        "Where the detector looks from",
        ("VIEW", "View", "Where you look from, as you move around"),
        ("CAMERA", "Camera", "The scene's camera"),
    )
    eye_background: props.whole(
        "Background",
        "Which background stands behind the body: a photograph of the training's folder by its number, or "
        "a procedural scene where there is none",
        min=0,
        max=9999,
    )

    people: props.path(
        "People", "People in photographs to wear the cloak: a people.json as COCO has them, or the folder it lies in"
    )

    film_format: props.choice(
        "Format",
        "What to write",
        ("gif", "GIF", "Plays everywhere, large"),
        ("mp4", "MP4", "Small; the trainer's Python needs the extra 'film' (PyAV)"),
        ("png", "Pictures", "A folder of PNGs"),
    )
    film_seconds: props.number("Turntable", "Seconds that a turntable takes", 6.0, min=0.5, max=120.0, subtype="TIME")

    @property
    def frames(self) -> PoseChoice | None:
        """This body's frames to evaluate on; None for the bodies that were kept back."""
        if self.bodies == "KEPT":
            return None
        return PoseChoice("RANGE", self.frame_start, self.frame_end, self.frame_step)

    @property
    def backgrounds_option(self) -> str:
        """The trainer's option for the evaluation's backgrounds."""
        return f"--backgrounds={absolute(self.backgrounds) or 'procedural:test'}"


THRESHOLD = 0.6  # of records that do not say theirs
SUMMARY = Path("evaluation", "summary.json")
CONTROLS = {"logo": "Cloak", "clothing": "Own clothing", "grey": "Grey", "random": "Random"}
"""What is compared, by its name in the summary, and its name in the panel."""


@dataclass(frozen=True)
class Rate:
    """A share of images in which the detector reports no person, with its 95 % interval; None where unknown."""

    value: float | None
    low: float | None
    high: float | None

    def describe(self) -> str:
        """94 % (88 to 97)."""
        if self.value is None:
            return "–"
        span = "" if self.low is None or self.high is None else f" ({100 * self.low:.0f}–{100 * self.high:.0f})"
        return f"{self.value:.0%}{span}"


@dataclass(frozen=True)
class Sector:
    """Success at one azimuth."""

    azimuth: float  # degrees; 0 looks at the front, positive ones stand to the body's left
    cloak: float
    clothing: float | None  # of the body in its own clothing: where that is high, the cloak has nothing to hide
    images: int


@dataclass(frozen=True)
class Judged:
    """What one detector made of the images."""

    spec: str
    operating_point: float | None
    rates: dict[str, tuple[Rate, Rate]]  # by control: at the threshold, and at the detector's own point
    sectors: tuple[Sector, ...]


@dataclass(frozen=True)
class Evaluation:
    """An evaluation."""

    detectors: tuple[Judged, ...]
    threshold: float
    images: int
    unseen: dict[str, bool | None]
    """Whether bodies and backgrounds were kept from the training; None where that is not known."""
    outdated: bool = False  # the run has newer colours than the evaluated ones

    def describe(self) -> str:
        """Describe the evaluated images in one line."""
        words = {True: "unseen {}", False: "{} of the training", None: "{} that may have been seen"}
        parts = [words[self.unseen.get(what)].format(what) for what in ("bodies", "backgrounds")]
        return f"{self.images:,} images of each kind, {' and '.join(parts)}"

    def worst_rates(self) -> dict[str, float]:
        """Return the lowest success over the detectors for each control."""
        rates = [(name, rate.value) for name, (rate, _) in chain(*(judged.rates.items() for judged in self.detectors))]
        known = sorted((name, value) for name, value in rates if value is not None)
        return dict(reversed(known))  # of several for one name the last one stays: the lowest

    def worst_sectors(self) -> tuple[Sector, ...]:
        """Return the lowest success over the detectors for each azimuth."""
        sectors = sorted(chain(*(d.sectors for d in self.detectors)), key=lambda sector: (sector.azimuth, sector.cloak))
        return tuple(next(group) for _, group in groupby(sectors, key=lambda sector: sector.azimuth))


def read_evaluation(run: Path) -> Evaluation | None:
    """The evaluation in a run folder; None where there is none, or none that can be read."""
    path = run / SUMMARY
    try:
        summary = read_json(path)
        detectors = read_judged(summary, CONTROLS)
        unseen = {what: summary.get("unseen", {}).get(what) for what in ("bodies", "backgrounds")}
        threshold = float(summary.get("settings", {}).get("threshold", THRESHOLD))
        images = int(summary.get("n") or sum(sector.images for sector in detectors[0].sectors))
        outdated = (run / "colors.npy").stat().st_mtime > path.stat().st_mtime
    except UNREADABLE:
        return None
    return Evaluation(detectors, threshold, images, unseen, outdated)


def read_judged(record: dict, names: Iterable[str] = ()) -> tuple[Judged, ...]:
    """Each detector's rates in an answer of the trainer, of what has these names; of all that has rates for none."""
    detectors = []
    for spec, answer in record["detectors"].items():
        known = [name for name in names or answer if isinstance(answer.get(name), dict)]
        rates = {name: (_rate(answer[name], ""), _rate(answer[name], "_own")) for name in known}
        sectors = []
        for name, measured in answer.get("by_angle", {}).items():
            azimuth, cloak, images = float(name), finite(measured.get("success")), int(measured.get("n") or 0)
            if cloak is not None and images:
                found = measured.get("n_conditional")  # images in which the body was found in its own clothing
                clothing = 1 - found / images if isinstance(found, int) else None
                sectors.append(Sector(azimuth, cloak, clothing, images))
        detectors.append(Judged(spec, record.get("operating_points", {}).get(spec), rates, tuple(sectors)))
    return tuple(detectors)


def _rate(record: dict, suffix: str) -> Rate:
    low, high = record.get(f"ci95{suffix}") or (None, None)
    return Rate(finite(record.get(f"success{suffix}")), finite(low), finite(high))


def kept_back(run: Path) -> bool:
    """Whether the run was trained on Cloak's sample people, some of whom are held out."""
    try:
        inputs = read_json(run / "config.json").get("inputs", {})
        return str(inputs.get("made_from") or inputs.get("scene", "")).startswith(tuple(SAMPLES.values()))
    except (InputError, AttributeError):
        return False
