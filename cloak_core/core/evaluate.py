"""Evaluate: measure images of people in patterns by detectors, count, and say what the figures are of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.evaluation.measure import OnImages, OnProgress, kept_frozen, measure
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.settings import EvaluateSettings, WearSettings
from cloak_core.core.evaluation.statistics import summarize
from cloak_core.core.images import ImageSet, Indices
from cloak_core.core.pattern import Pattern
from cloak_core.files.identity import package_versions, sha256_record

MEASUREMENT_VERSION = 5
"""Raise it by one when the same images, patterns and detectors give other scores or boxes than before: after a change
of rendering, sampling, detectors, or of what is kept of their answers. The golden tests say when."""
Patterns = Mapping[str, Pattern]
"""What is worn, by name: what is judged first, then its controls."""


def evaluate(
    images: ImageSet,
    patterns: Patterns,
    detectors: dict[str, Detector],
    settings: EvaluateSettings | WearSettings,
    circumstances: Mapping[str, object],
    on_progress: OnProgress | None = None,
    on_images: OnImages | None = None,
    bare: Indices | None = None,
) -> tuple[dict, Results]:
    """Measure every pattern on the same images, and count: contract C6's figures, with the circumstances beside them.

    circumstances: more keys of the summary; `inputs`, which gets the detectors' hashes and the evaluation's identity,
    is among them. bare: see `measure_frozen`.
    """
    results, hashes = measure_frozen(images, patterns, detectors, settings, on_progress, on_images, bare)
    summary = summarize(results, settings.threshold, settings.resamples)
    summary |= {"n": len(images.trials)} | detector_facts(detectors) | dict(circumstances)
    content = identity(images, patterns, detectors, settings)
    summary["inputs"] = summary["inputs"] | {"detector_hashes": hashes} | ({"content": content} if content else {})
    return summary, results


def measure_frozen(
    images: ImageSet,
    patterns: Patterns,
    detectors: dict[str, Detector],
    settings: EvaluateSettings | WearSettings,
    on_progress: OnProgress | None = None,
    on_images: OnImages | None = None,
    bare: Indices | None = None,
) -> tuple[Results, dict[str, str]]:
    """Measure, and return the detectors' hashes, which the evaluation must not change.

    bare: backgrounds without people that are looked at; None: as many as the settings say, drawn by the seed.
    """
    if bare is None:
        bare = bare_backgrounds(len(images.background_names), settings)
    more = {"batch": settings.batch, "on_progress": on_progress, "on_images": on_images}
    with kept_frozen(detectors) as hashes:
        results = measure(images, patterns, detectors, bare, **more)
    return results, hashes


def identity(
    images: ImageSet, patterns: Patterns, detectors: Mapping[str, Detector], settings: EvaluateSettings | WearSettings
) -> str | None:
    """Hash (SHA-256, hex) all that decides an evaluation; None where that is not known.

    Not known: images that somebody else renders, or a detector that no family loaded, whose code may be anything.
    """
    shown = images.identity
    # What cannot be known of an object equals nothing else, see `files.identity.UNKNOWN`.
    if shown is None or not all(detector.source for detector in detectors.values()):
        return None
    judges = [
        [spec, detector_record(detector), detector.operating_point, detector.device.type]
        for spec, detector in detectors.items()
    ]
    around = {"version": MEASUREMENT_VERSION, "packages": package_versions("torch", "numpy", "numba", "pillow")}
    worn = {name: pattern.identity for name, pattern in patterns.items()}
    return sha256_record([shown, worn, list(worn), judges, asdict(settings), around])


def bare_backgrounds(count: int, settings: EvaluateSettings) -> np.ndarray:
    """Choose which of `count` backgrounds are looked at with nobody in front: of too many, a draw by the seed."""
    order = np.random.default_rng([settings.seed, 0xBA2E]).permutation(count)
    return np.sort(order[: settings.bare])


def detector_facts(detectors: Mapping[str, Detector]) -> dict:
    """Return the summary's `operating_points`, by spec, and which of them are assumed."""
    points = {spec: detector.operating_point for spec, detector in detectors.items()}
    assumed = [spec for spec, detector in detectors.items() if detector.operating_point_assumed]
    return {"operating_points": points, "operating_points_assumed": assumed}


def headline(record: Mapping[str, object]) -> dict:
    """Select success at both thresholds, intervals and count of one S of contract C6; None for what it lacks."""
    return {key: record.get(key) for key in ("success", "success_own", "ci95", "ci95_own", "n")}
