"""Measure a source's images under every control, and count: one record of all that was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.evaluation.measure import OnProgress, all_controls, kept_frozen, measure
from cloak_core.core.evaluation.renderer import EvaluationRenderer
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.statistics import summarize
from cloak_core.files.identity import code_hash, package_versions, sha256_record

ROOMS = ("exchange", "core", "sources", "detectors", "studies")
"""The rooms whose code decides the figures of an evaluation."""


def measure_and_count(
    renderer: EvaluationRenderer,
    detectors: dict[str, Detector],
    settings: EvaluateSettings,
    circumstances: Mapping[str, object],
    controls: Sequence[str] | None = None,
    on_progress: OnProgress | None = None,
) -> tuple[dict, Results]:
    """Measure the renderer's trials; return `summarize`, `detector_facts` and the circumstances in one record.

    circumstances: more keys of the record; `settings` and `inputs` (which gets the detectors' hashes) are among them.
    controls: see `measure_frozen`.
    """
    results, hashes = measure_frozen(renderer, detectors, settings, on_progress, controls)
    summary = summarize(results, settings.threshold, settings.resamples)
    summary |= {"n": len(renderer.trials)} | detector_facts(detectors) | dict(circumstances)
    summary["inputs"] = summary["inputs"] | {"detector_hashes": hashes}
    return summary, results


def content_hash(detectors: Mapping[str, Detector], circumstances: Mapping[str, object]) -> str | None:
    """Hash (SHA-256, hex) all that decides an evaluation; None where that is not known.

    Not known: inputs without an `identity`, or a detector that no family loaded, whose code may be anything.
    """
    # What cannot be known of an object equals nothing else, see `files.identity.UNKNOWN`.
    if "identity" not in circumstances["inputs"] or not all(detector.source for detector in detectors.values()):
        return None
    judges = [
        [spec, detector_record(detector), detector.operating_point, detector.device.type]
        for spec, detector in detectors.items()
    ]
    around = {"code": code_hash(*ROOMS), "packages": package_versions("torch", "numpy", "numba", "pillow")}
    return sha256_record([judges, dict(circumstances), around])


def measure_frozen(
    renderer: EvaluationRenderer,
    detectors: dict[str, Detector],
    settings: EvaluateSettings,
    on_progress: OnProgress | None = None,
    controls: Sequence[str] | None = None,
) -> tuple[Results, dict[str, str]]:
    """Measure, and return the detectors' hashes, which the evaluation must not change.

    controls: what is measured, the trained colours first; None: the settings' controls.
    """
    bare = bare_backgrounds(len(renderer.background_names), settings)
    controls = controls or all_controls(settings)
    with kept_frozen(detectors) as hashes:
        results = measure(renderer, detectors, controls, bare, batch=settings.batch, on_progress=on_progress)
    return results, hashes


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
