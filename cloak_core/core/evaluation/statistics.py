"""Count: rates with their intervals and threshold curves, from rows of the results table.

Every figure that an evaluation, card, matrix, film or experiment shows is computed here, from rows of
`Results.images` (or of a table with the same columns) and, for average precision (`precision`), from `Results.boxes`;
what cards, films and photographs have of their own stands in `studies/statistics_*.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool, Shaped

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.evaluation import CLOTHING, LOGO
from cloak_core.core.evaluation.intervals import RESAMPLES, Rate, clustered_rate
from cloak_core.core.evaluation.precision import OVERLAPS, average_precision
from cloak_core.core.evaluation.results import NOBODY, Results

HALF = 0.5
"""The threshold that most of the literature counts at."""
THRESHOLDS = tuple(round(0.1 * k, 1) for k in range(1, 10))
CLUSTERS = (("person", "pose"), ("photograph", "background"), ("training",))
"""Columns of what images share; those with the same value succeed and fail together. Of each group, the first column
that the table has."""
NAMED = 3
"""How many of the classes that were reported instead of a person are named."""


# --- of some rows


def undetected(rows: pd.DataFrame, threshold: float = THRESHOLD, column: str = "score") -> Bool[np.ndarray, " N"]:
    """Mark the images in which no person is reported: the best score is at most `threshold`.

    column: "score" for anywhere in the image, "score_on" for on the body.
    """
    return rows[column].to_numpy() <= threshold


def rate(
    rows: pd.DataFrame,
    hits: Shaped[np.ndarray, " N"],
    clusters: Sequence[str] | None = None,
    resamples: int = RESAMPLES,
) -> Rate:
    """Estimate the share of `hits` (booleans, or parts in [0, 1]) with its 95 % cluster-bootstrap interval.

    clusters: the columns of what images share; `CLUSTERS` unless given.
    """
    names = clusters or [next(name for name in group if name in rows) for group in CLUSTERS]
    ways = [np.unique(rows[name].to_numpy(), return_inverse=True)[1].astype(np.int64) for name in names]
    return clustered_rate(np.asarray(hits), *ways, resamples=resamples)


def hidden_rate(rows: pd.DataFrame, threshold: float = THRESHOLD, column: str = "score") -> Rate:
    """Estimate attack success: the share of images in which no person is reported."""
    return rate(rows, undetected(rows, threshold, column))


def found_rate(rows: pd.DataFrame, threshold: float = THRESHOLD, column: str = "score") -> Rate:
    """Estimate recall, or on bare backgrounds false alarms: the share of images with a reported person."""
    return rate(rows, ~undetected(rows, threshold, column))


def success_rate(rows: pd.DataFrame, threshold: float = THRESHOLD, column: str = "score") -> float:
    """Compute attack success without an interval; nan without rows."""
    return float(undetected(rows, threshold, column).mean()) if len(rows) else math.nan


def conditional_rate(rows: pd.DataFrame, threshold: float = THRESHOLD, resamples: int = RESAMPLES) -> Rate:
    """Estimate attack success among images whose body is found in its own clothing."""
    seen = rows[(rows["clean"] > threshold).to_numpy()]
    return rate(seen, undetected(seen, threshold), resamples=resamples)


def by_training(rows: pd.DataFrame) -> list[float]:
    """Compute attack success of each repetition of the training."""
    return [success_rate(part) for _, part in rows.groupby("training")]


# --- records: plain values, ready for JSON


def summarize(results: Results, threshold: float = THRESHOLD, resamples: int = RESAMPLES) -> dict:
    """Count contract C6's `detectors` and `false_alarms`: every control's rates, by angle and by body, per detector."""
    detectors = {spec: _detector_summary(results, spec, threshold, resamples) for spec in results.detectors}
    alarms = {spec: finite(false_alarms(results, spec, threshold)) for spec in results.detectors}
    return {"detectors": detectors, "false_alarms": alarms}


def _detector_summary(results: Results, spec: str, threshold: float, resamples: int) -> dict:
    def record(rows: pd.DataFrame) -> dict:
        return success_record(results, rows, threshold, resamples)

    rows = {control: results.rows(spec, control) for control in results.controls}
    summary = {control: record(part) | side_record(part, threshold) for control, part in rows.items()}
    logo = rows[results.controls[0]]
    summary["by_angle"] = {f"{angle:g}": record(part) for angle, part in logo.groupby("angle")}
    summary["by_body"] = {results.body_names[pose]: record(part) for pose, part in logo.groupby("pose") if pose >= 0}
    for column in ("distance", "elevation"):
        if logo[column].nunique() > 1:
            summary[f"by_{column}"] = {f"{value:g}": record(part) for value, part in logo.groupby(column)}
    curves = {control: threshold_curve(part) for control, part in rows.items()}
    summary["by_threshold"] = {
        f"{t:.1f}": {control: round(curve[k], 6) for control, curve in curves.items()} for k, t in enumerate(THRESHOLDS)
    }
    summary["average_precision"] = {c: finite(average_precision(results, part)) for c, part in rows.items()}
    return summary


def success_record(
    results: Results, rows: pd.DataFrame, threshold: float = THRESHOLD, resamples: int = RESAMPLES
) -> dict:
    """Count one S of contracts C6 and C8, over rows of one detector and control.

    `success`: no person box above the threshold anywhere; `success_own`: none above the detector's own threshold;
    `success_05`: none above 0.5; `masr`: mean success over the thresholds 0.1 to 0.9;
    `success_iou`: none on the body; `conditional`: success where the same image with the body's own clothing is
    detected, null where none is (`n_conditional` images are); `ap50` and `ap50_95`: `average_precision` of these
    images. `renamed`, `gone`, `named`: see `outcome_record`. `success_own` is null where that threshold is unknown.
    """
    point = operating_point(rows)
    known = rows if point is not None else rows[:0]
    success = rate(rows, undetected(rows, threshold), resamples=resamples)
    conditional = conditional_rate(rows, threshold, resamples)
    return {
        **rate_record("success", success),
        **rate_record("success_own", rate(known, undetected(known, point or 0.0), resamples=resamples)),
        **published_rates(rows, resamples=resamples),
        **rate_record("success_iou", rate(rows, undetected(rows, threshold, "score_on"), resamples=resamples)),
        **rate_record("conditional", conditional),
        "n": success.n,
        "n_conditional": conditional.n,
        "mean_score": finite(float(rows["score"].to_numpy().mean()) if len(rows) else math.nan),
        "ap50": finite(average_precision(results, rows)),
        "ap50_95": finite(average_precision(results, rows, OVERLAPS)),
        **outcome_record(rows, threshold),
    }


def published_rates(rows: pd.DataFrame, places: int = 6, resamples: int = RESAMPLES) -> dict:
    """Compute what others publish: success at 0.5, and mASR, the mean of success over `THRESHOLDS`."""
    over_thresholds = np.mean([undetected(rows, t) for t in THRESHOLDS], axis=0)
    at_half = rate(rows, undetected(rows, HALF), resamples=resamples)
    mean = rate(rows, over_thresholds, resamples=resamples)
    return rate_record("success_05", at_half, places) | rate_record("masr", mean, places)


def rate_record(name: str, value: Rate, places: int = 6) -> dict:
    """Name a rate and its interval; nulls without images.

    "success" and "recall" go with "ci95", "success_own" with "ci95_own", any other NAME with "ci95_NAME".
    """
    end = name.removeprefix("success").removeprefix("recall").strip("_")
    bounds = [finite(bound, places) for bound in (value.low, value.high)]
    return {name: finite(value.value, places), "ci95" + (f"_{end}" if end else ""): bounds}


def outcome_record(rows: pd.DataFrame, threshold: float = THRESHOLD) -> dict:
    """Count what became of the person in images without a reported one, at `threshold` and (`_own`) the own (C8).

    `renamed`: share of images in which something else is reported on the body; `gone`: nothing is; `named`: the most
    frequent names of the former. Nulls where the detector does not tell of other classes.
    """
    has_others = bool(len(rows)) and bool(rows["other"].notna().all())
    record: dict = {}
    for suffix, at in (("", threshold), ("_own", operating_point(rows))):
        known = has_others and at is not None
        gone = undetected(rows, at) if known else np.zeros(0, bool)
        other = rows["other"].to_numpy() > at if known else gone
        record[f"renamed{suffix}"] = finite(float((gone & other).mean())) if known else None
        record[f"gone{suffix}"] = finite(float((gone & ~other).mean())) if known else None
        names = rows["other_name"][gone & other].value_counts() if known else {}
        record[f"named{suffix}"] = {str(name): int(n) for name, n in list(names.items())[:NAMED]} if known else None
    return record


def side_record(rows: pd.DataFrame, threshold: float = THRESHOLD) -> dict:
    """Count success among people seen from the front, the side and the back: {"seen_from": ...}.

    {} for images whose table has no column `seen_from`.
    """
    if "seen_from" not in rows:
        return {}
    point = operating_point(rows)
    sides = {}
    for side in ("front", "side", "back"):
        seen = rows[(rows["seen_from"] == side).to_numpy()]
        if len(seen):
            own = None if point is None else finite(success_rate(seen, point))
            sides[side] = {"n": len(seen), "success": finite(success_rate(seen, threshold)), "success_own": own}
    return {"seen_from": sides}


def operating_point(rows: pd.DataFrame) -> float | None:
    """Return the detector's own threshold, None where it is unknown or there are no rows."""
    point = float(rows["operating_point"].iloc[0]) if len(rows) else math.nan
    return point if math.isfinite(point) else None


def false_alarms(results: Results, spec: str, threshold: float = THRESHOLD) -> float:
    """Compute the share of bare backgrounds on which the detector reports a person."""
    return 1 - success_rate(rows, threshold) if len(rows := results.rows(spec, NOBODY)) else math.nan


def matched_threshold(scores: Shaped[np.ndarray, " N"], reference: Shaped[np.ndarray, " M"]) -> float:
    """Find the threshold at which `scores` raise no more false alarms than `reference` does at 0.6.

    Both are best scores on pictures without people. Returns the lowest such threshold, at least 0.
    """
    allowed = round(float((reference > THRESHOLD).mean()) * len(scores))
    ordered = np.sort(scores)[::-1]
    return float(ordered[allowed]) if allowed < len(scores) else 0.0


def threshold_curve(rows: pd.DataFrame) -> list[float]:
    """Compute attack success at every one of `THRESHOLDS`."""
    return [success_rate(rows, t) for t in THRESHOLDS]


def rate_row(value: Rate, name: str = "success", low: str = "low", high: str = "high") -> dict:
    """Write one rate as columns of a table: its value, its bounds and the number of images, four digits."""
    return {name: digits(value.value), low: digits(value.low), high: digits(value.high), "n": value.n}


def training_row(results: Results, spec: str) -> dict:
    """Everything a table says about the repetitions of a training under one detector: plain numbers, four digits."""
    rows, clean = results.rows(spec, LOGO), results.rows(spec, CLOTHING)
    spread = [round(value, 6) for value in by_training(rows)]
    others = {control: success_rate(results.rows(spec, control)) for control in results.controls[1:]}
    more = {
        "success_iou": hidden_rate(rows, column="score_on").value,
        "conditional": conditional_rate(rows).value,
        # Unlike success it does not saturate at 0 or 100 %.
        "mean_score": float(np.mean([part["score"].to_numpy().mean() for _, part in rows.groupby("training")])),
        **others,
        "clean_detection": 1 - others[CLOTHING],
        "average_precision": average_precision(results, rows),
        "clean_average_precision": average_precision(results, clean),
        "false_alarms": false_alarms(results, spec),
    }
    seeds = {"seeds": len(spread), "worst_seed": digits(min(spread)), "best_seed": digits(max(spread))}
    row = {"detector": spec} | rate_row(hidden_rate(rows))
    return row | {key: digits(value) for key, value in more.items()} | seeds


def operating_row(results: Results, spec: str) -> dict:
    """Add to `training_row` what is told at the detector's own threshold, which has to be known.

    Each control is told at both thresholds; `clean_*` is the bodies' own clothing.
    """
    row = training_row(results, spec)
    rows = results.rows(spec, LOGO)
    point = operating_point(rows)
    missed = {control: success_rate(results.rows(spec, control), point) for control in results.controls[1:]}
    more = {f"{control}_own": value for control, value in missed.items()}
    more |= {"operating_point": point, "clean_recall_own": 1 - missed[CLOTHING]}
    more |= {"false_alarms_own": false_alarms(results, spec, point)}
    own = rate_row(hidden_rate(rows, point), "success_own", "own_low", "own_high")
    same = {"ap50": "average_precision", "clean_ap50": "clean_average_precision", "clean_recall": "clean_detection"}
    row |= {name: row[column] for name, column in same.items()}
    return row | own | {key: digits(value) for key, value in more.items()}


def rows_at(results: Results, spec: str, column: str, values: Sequence[float], **where: float) -> list[dict]:
    """Make one row for each angle or distance: success with its interval, every control beside it, four digits."""
    table = []
    for value in values:
        place = where | {column: value}
        shares = {c: digits(success_rate(results.rows(spec, c, **place))) for c in results.controls[1:]}
        rates = rate_row(hidden_rate(results.rows(spec, LOGO, **place)))
        table.append({"detector": spec, column: value} | rates | shares)
    return table


# --- plain numbers


def finite(value: float, places: int = 6) -> float | None:
    """Round a value, or return None where it is not finite: JSON knows no nan."""
    return round(value, places) if math.isfinite(value) else None


def digits(value: float | None) -> float | None:
    """Four digits, as tables show them."""
    return None if value is None else finite(float(value), 4)
