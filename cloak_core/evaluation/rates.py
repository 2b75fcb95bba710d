"""From a measurement to the numbers people read: success rates with intervals, curves over thresholds, precision."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Shaped

from cloak_core.detectors import IOU, THRESHOLD
from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.intervals import RESAMPLES, Rate, clustered_rate
from cloak_core.evaluation.measurement import Measurement
from cloak_core.evaluation.precision import OVERLAPS, average_precision_of, first_hits

THRESHOLDS = tuple(round(0.1 * k, 1) for k in range(1, 10))


def summarize(
    measurement: Measurement,
    threshold: float = THRESHOLD,
    resamples: int = RESAMPLES,
    operating_points: Mapping[str, float] | None = None,
) -> dict:
    """Contract C6's `detectors` and `false_alarms`: rates of every control, by angle and by body, per detector.

    operating_points: each detector's own threshold, by spec, for `success_own`; without one it is null.
    """
    detectors = {}
    for d, spec in enumerate(measurement.specs):
        asked = {"threshold": threshold, "resamples": resamples, "own": (operating_points or {}).get(spec)}
        rates = {control: rate_record(measurement, d, c, **asked) for c, control in enumerate(measurement.controls)}
        trials = measurement.trials
        groups = {
            "by_angle": {f"{a:g}": trials.angle == a for a in np.unique(trials.angle)},
            "by_body": {measurement.body_names[p]: trials.pose == p for p in np.unique(trials.pose)},
        }
        for place in ("distance", "elevation"):
            values = getattr(trials, place)
            if len(np.unique(values)) > 1:
                groups[f"by_{place}"] = {f"{x:g}": values == x for x in np.unique(values)}
        for name, masks in groups.items():
            rates[name] = {key: rate_record(measurement, d, 0, mask, **asked) for key, mask in masks.items()}
        rates["by_threshold"] = threshold_curves(measurement, d)
        rates["average_precision"] = {
            control: _finite(average_precision(measurement, d, c)) for c, control in enumerate(measurement.controls)
        }
        detectors[spec] = rates
    alarms = {spec: _finite(float((measurement.bare[d] > threshold).mean())) for d, spec in enumerate(detectors)}
    return {"detectors": detectors, "false_alarms": alarms}


def rate_record(
    measurement: Measurement,
    detector: int,
    control: int,
    mask: Bool[np.ndarray, N] | None = None,
    *,
    threshold: float = THRESHOLD,
    resamples: int = RESAMPLES,
    own: float | None = None,
) -> dict:
    """One S of contract C6, over the images of `mask`.

    `success`: no person box above the threshold anywhere; `success_own`: none above the detector's own one;
    `success_iou`: none on the body; `conditional`: success where the same image with the body's own clothing is
    detected, null where none is (`n_conditional` images are); `ap50` and `ap50_95`: `average_precision` of these
    images (the latter null where an earlier version measured).
    """
    mask = np.ones(len(measurement.trials), bool) if mask is None else mask
    gone = measurement.score[detector, control] <= threshold
    gone_on = measurement.score_on[detector, control] <= threshold
    clean = measurement.controls.index(CLOTHING)
    seen = mask & (measurement.score[detector, clean] > threshold)
    asked = ((gone, mask), (gone_on, mask), (gone, seen))
    anywhere, on_body, conditional = (_rate(measurement, hits, where, resamples) for hits, where in asked)
    return {
        "success": _finite(anywhere.value),
        "success_iou": _finite(on_body.value),
        "conditional": _finite(conditional.value),
        "n": anywhere.n,
        "ci95": _interval(anywhere),
        "ci95_iou": _interval(on_body),
        "ci95_conditional": _interval(conditional),
        "n_conditional": conditional.n,
        "mean_score": _finite(float(measurement.score[detector, control][mask].mean()) if mask.any() else math.nan),
        "ap50": _finite(average_precision(measurement, detector, control, mask)),
        "ap50_95": _finite(average_precision(measurement, detector, control, mask, OVERLAPS)),
    } | _own_record(measurement, detector, control, mask, own, resamples)


def _own_record(
    measurement: Measurement, detector: int, control: int, mask: np.ndarray, own: float | None, resamples: int
) -> dict:
    """Success at the detector's own threshold, with its interval."""
    if own is None:
        return {"success_own": None, "ci95_own": [None, None]}
    rate = _rate(measurement, measurement.score[detector, control] <= own, mask, resamples)
    return {"success_own": _finite(rate.value), "ci95_own": _interval(rate)}


def threshold_curves(measurement: Measurement, detector: int) -> dict[str, dict[str, float]]:
    """Success of every control at thresholds 0.1, 0.2, ... 0.9: {"0.1": {"logo": x, ...}, ...}."""
    score = measurement.score[detector]
    return {
        f"{t:.1f}": {name: round(float((score[c] <= t).mean()), 6) for c, name in enumerate(measurement.controls)}
        for t in THRESHOLDS
    }


def average_precision(
    measurement: Measurement,
    detector: int,
    control: int,
    mask: Bool[np.ndarray, N] | None = None,
    overlaps: Sequence[float] = (IOU,),
) -> float:
    """COCO's average precision of these images, or all: AP50, or the mean over several overlaps (`OVERLAPS`: AP50:95).

    nan without images, and for other overlaps than 0.5 where an earlier version measured.
    """
    boxes = measurement.boxes
    mask = np.ones(len(measurement.trials), bool) if mask is None else mask
    mine = (boxes.detector == detector) & (boxes.control == control) & mask[boxes.image]
    score, iou, image = boxes.score[mine], boxes.iou[mine], boxes.image[mine]
    if np.isnan(iou).any() and set(overlaps) != {IOU}:
        return math.nan
    hits = (boxes.hit[mine] if overlap == IOU else first_hits(iou, image, overlap) for overlap in overlaps)
    return float(np.mean([average_precision_of(hit, score, int(mask.sum())) for hit in hits]))


def group_rates(
    measurement: Measurement,
    detector: int,
    control: int,
    values: Shaped[np.ndarray, N],
    threshold: float = THRESHOLD,
    resamples: int = RESAMPLES,
) -> tuple[np.ndarray, list[Rate]]:
    """Success at every distinct value of a trial column (angle, distance): the values, sorted, and their rates."""
    gone = measurement.score[detector, control] <= threshold
    keys = np.unique(values)
    return keys, [_rate(measurement, gone, values == key, resamples) for key in keys]


def _rate(measurement: Measurement, hits: np.ndarray, where: np.ndarray, resamples: int) -> Rate:
    trials = measurement.trials
    return clustered_rate(hits[where], trials.pose[where], trials.background[where], resamples=resamples)


def _interval(rate: Rate) -> list[float | None]:
    return [_finite(rate.low), _finite(rate.high)]


def _finite(value: float) -> float | None:
    """JSON knows no nan."""
    return round(value, 6) if math.isfinite(value) else None
