"""From measurements to a card's figures: shares with their intervals, as plain values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.experiments.repeats import Repeats
from cloak_core.evaluation.intervals import Rate, clustered_rate, wilson
from cloak_core.evaluation.measurement import Measurement
from cloak_core.evaluation.precision import OVERLAPS
from cloak_core.evaluation.rates import THRESHOLDS, average_precision


def figures(name: str, rate: Rate) -> dict:
    """The share and its interval: "success" goes with "ci95", "success_own" with "ci95_own"; nulls for no image."""
    plain = [None if np.isnan(x) else round(x, 4) for x in (rate.value, rate.low, rate.high)]
    _, _, end = name.partition("_")
    return {name: plain[0], "ci95" + (f"_{end}" if end else ""): plain[1:]}


def attacked(result: Repeats, spec: str, own: float) -> dict:
    """What a cloak does to a detector: success at 0.6 and at its `own` threshold, their mean over 0.1 to 0.9 (masr),
    AP50 and AP50:95; own clothing and random colours beside them."""
    masr = figures("masr", _masr(result, spec))
    curve = {f"{t:g}": round(result.rate(spec, threshold=t).value, 4) for t in THRESHOLDS}
    row = figures("success", result.rate(spec)) | figures("success_own", result.rate(spec, threshold=own))
    row |= {"masr": masr["masr"], "ci95_masr": masr["ci95"], "by_threshold": curve}
    for control in result.controls[1:]:
        row[control] = round(result.rate(spec, control).value, 4)
        row[f"{control}_own"] = round(result.rate(spec, control, threshold=own).value, 4)
    d = result.specs.index(spec)
    row |= precisions(result.measurements, d, 0)
    return row | {"n": len(result.trials) * len(result.measurements), "seeds": len(result.measurements)}


def _masr(result: Repeats, spec: str) -> Rate:
    """Mean success over the thresholds 0.1, 0.2 ... 0.9."""
    d, count, trials = result.specs.index(spec), len(result.measurements), result.trials
    hidden = [np.mean([m.score[d, 0] <= t for t in THRESHOLDS], axis=0) for m in result.measurements]
    ways = (np.tile(way, count) for way in (trials.pose, trials.background))
    return clustered_rate(np.concatenate(hidden), *ways, np.repeat(np.arange(count), len(trials)))


def precisions(measurements: Sequence[Measurement], detector: int, control: int) -> dict:
    """AP50 and AP50:95, the mean of repetitions."""
    means = {
        name: float(np.mean([average_precision(m, detector, control, overlaps=overlaps) for m in measurements]))
        for name, overlaps in (("ap50", (0.5,)), ("ap50_95", OVERLAPS))
    }
    return {name: round(value, 4) for name, value in means.items()}


def by_angle(result: Repeats, spec: str, own: float) -> dict[str, dict]:
    """Success at both thresholds for each azimuth."""
    angles = np.unique(result.trials.angle)
    rates = {a: (result.rate(spec, angle=a), result.rate(spec, threshold=own, angle=a)) for a in map(float, angles)}
    return {f"{a:g}": figures("success", r) | figures("success_own", o) for a, (r, o) in rates.items()}


def clean(measurement: Measurement, own: float) -> dict:
    """Recall in own clothing, average precision and false alarms of the only detector of a measurement."""
    found = measurement.score[0, measurement.controls.index(CLOTHING)]
    body = measurement.score_on[0, measurement.controls.index(CLOTHING)]
    row = _recalls(measurement, found, own, np.ones(len(found), bool))
    row |= figures("recall_on_body", _share(measurement, body > THRESHOLD, np.ones(len(found), bool)))
    row |= precisions([measurement], 0, measurement.controls.index(CLOTHING))
    for name, threshold in (("false_alarms", THRESHOLD), ("false_alarms_own", own)):
        share, count = float((measurement.bare[0] > threshold).mean()), measurement.bare.shape[1]
        row |= {name: round(share, 4), f"ci95_{name}": [round(x, 4) for x in wilson(share, count)]}
    return row | {"backgrounds": measurement.bare.shape[1]}


def recall_by(measurement: Measurement, own: float) -> dict[str, dict[str, dict]]:
    """Recall in own clothing by distance (m), azimuth, elevation (degrees), body and pose, each by its value."""
    trials = measurement.trials
    bodies = np.array(measurement.body_names)[trials.pose]
    ways: Mapping[str, np.ndarray] = {
        "distance": trials.distance,
        "azimuth": trials.angle,
        "elevation": trials.elevation,
        "body": bodies,
        "pose": np.array([pose_of(name) for name in bodies]),
    }
    found = measurement.score[0, measurement.controls.index(CLOTHING)]
    return {
        way: {_label(v): _recalls(measurement, found, own, values == v) for v in np.unique(values)}
        for way, values in ways.items()
    }


def pose_of(name: str) -> str:
    """What a body's name says of its pose: "walking-10" is walking, as is everything before a number at the end."""
    return re.sub(r"[-_ .]*\d+$", "", name) or name


def _label(value: object) -> str:
    return str(value) if isinstance(value, str) else f"{float(value):g}"


def _recalls(
    measurement: Measurement, score: Float[np.ndarray, N], own: float, where: Bool[np.ndarray, N]
) -> dict[str, object]:
    recall = _share(measurement, score > THRESHOLD, where)
    row = figures("recall", recall) | figures("recall_own", _share(measurement, score > own, where))
    return row | {"n": recall.n}


def _share(measurement: Measurement, hits: Bool[np.ndarray, N], where: Bool[np.ndarray, N]) -> Rate:
    trials = measurement.trials
    return clustered_rate(hits[where], trials.pose[where], trials.background[where])


def controls(measurement: Measurement, own: float) -> dict[str, dict]:
    """Success of patterns that nobody trained, on shirt and trousers, beside own clothing; the logo's place holds
    black and white at random."""
    names = {LOGO: "noise"}
    rows = {}
    for c, control in enumerate(measurement.controls):
        gone = measurement.score[0, c]
        everywhere = np.ones(len(gone), bool)
        rates = [_share(measurement, gone <= threshold, everywhere) for threshold in (THRESHOLD, own)]
        rows[names.get(control, control)] = figures("success", rates[0]) | figures("success_own", rates[1])
    return rows
