# SPDX-License-Identifier: GPL-3.0-or-later
"""What `cloak evaluate` found out about a run, read from its folder."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, groupby
from pathlib import Path

from ..files.errors import InputError
from ..files.reading import read_json
from ..trainer.command_lines import SAMPLES
from ..trainer.progress import finite

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

    azimuth: float
    """Degrees; 0 looks at the front, positive ones stand to the body's left."""
    cloak: float
    clothing: float | None
    """Of the body in its own clothing: where that is high, the cloak has nothing to hide."""
    images: int


@dataclass(frozen=True)
class Judged:
    """What one detector made of the images."""

    spec: str
    operating_point: float | None
    rates: dict[str, tuple[Rate, Rate]]
    """By control: at the threshold, and at the detector's own point."""
    sectors: tuple[Sector, ...]


@dataclass(frozen=True)
class Evaluation:
    """An evaluation."""

    detectors: tuple[Judged, ...]
    threshold: float
    images: int
    unseen: dict[str, bool | None]
    """Whether bodies and backgrounds were kept from the training; None where that is not known."""
    outdated: bool = False
    """The run has newer colours than the evaluated ones."""

    def describe(self) -> str:
        """Describe the evaluated images in one line."""
        words = {True: "unseen {}", False: "{} of the training", None: "{} that may have been seen"}
        parts = [words[self.unseen.get(what)].format(what) for what in ("bodies", "backgrounds")]
        return f"{self.images:,} images of each kind, {' and '.join(parts)}"

    def worst_rates(self) -> dict[str, float]:
        """Return the lowest success over the detectors for each control."""
        worst: dict[str, float] = {}
        for name, (rate, _) in chain(*(judged.rates.items() for judged in self.detectors)):
            if rate.value is not None:
                worst[name] = min(worst.get(name, 1.0), rate.value)
        return worst

    def worst_sectors(self) -> tuple[Sector, ...]:
        """Return the lowest success over the detectors for each azimuth."""
        sectors = sorted(chain(*(d.sectors for d in self.detectors)), key=lambda sector: (sector.azimuth, sector.cloak))
        return tuple(next(group) for _, group in groupby(sectors, key=lambda sector: sector.azimuth))


def read_evaluation(run: Path) -> Evaluation | None:
    """The evaluation in a run folder; None where there is none, or none that can be read."""
    path = run / SUMMARY
    try:
        summary = read_json(path)
        detectors = tuple(_judged(spec, told, summary) for spec, told in summary["detectors"].items())
        unseen = {what: summary.get("unseen", {}).get(what) for what in ("bodies", "backgrounds")}
        threshold = float(summary.get("settings", {}).get("threshold", 0.6))
        images = int(summary.get("n") or sum(sector.images for sector in detectors[0].sectors))
        outdated = (run / "colors.npy").stat().st_mtime > path.stat().st_mtime
    except (InputError, OSError, KeyError, TypeError, ValueError, AttributeError, IndexError):
        return None
    return Evaluation(detectors, threshold, images, unseen, outdated)


def _judged(spec: str, told: dict, summary: dict) -> Judged:
    known = [name for name in CONTROLS if isinstance(told.get(name), dict)]
    rates = {name: (_rate(told[name], ""), _rate(told[name], "_own")) for name in known}
    sectors = []
    for name, record in told.get("by_angle", {}).items():
        azimuth, cloak, images = float(name), finite(record.get("success")), int(record.get("n") or 0)
        if cloak is not None and images:
            found = record.get("n_conditional")  # images in which the body was found in its own clothing
            clothing = 1 - found / images if isinstance(found, int) else None
            sectors.append(Sector(azimuth, cloak, clothing, images))
    return Judged(spec, summary.get("operating_points", {}).get(spec), rates, tuple(sectors))


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
