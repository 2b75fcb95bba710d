"""Count for robustness cards and leave-one-out matrices: plain values, four digits, from rows of the results table.

A figure is added to a card here; `card.leaderboard` says where it is shown.
"""

from __future__ import annotations

import re

import numpy as np
import pandas as pd

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.evaluation.controls import CLOTHING, LOGO, STANDARD
from cloak_core.core.evaluation.intervals import Rate, wilson
from cloak_core.core.evaluation.precision import OVERLAPS, average_precision
from cloak_core.core.evaluation.results import NOBODY, Results
from cloak_core.core.evaluation.statistics import (
    THRESHOLDS,
    by_training,
    digits,
    found_rate,
    hidden,
    hidden_rate,
    operating_point,
    outcome_record,
    rate,
    rate_record,
    share,
    threshold_curve,
)

LOW = 0.25
"""The threshold at which YOLOv5 and later are run."""
RECALL_BY = {
    "distance": "distance",
    "azimuth": "angle",
    "elevation": "elevation",
    "body": "body",
    "pose": "stance",
}
"""By what a card tells recall apart, and the column of the table."""


# --- cards


def success_rates(rows: pd.DataFrame) -> dict:
    """Compute success at 0.6 and (`_own`) at the detector's own threshold, each with its interval."""
    own = hidden_rate(rows, operating_point(rows))
    return rate_record("success", hidden_rate(rows), 4) | rate_record("success_own", own, 4)


def recall_rates(rows: pd.DataFrame) -> dict:
    """Compute recall at 0.6 and (`_own`) at the detector's own threshold, each with its interval."""
    recall, own = found_rate(rows), found_rate(rows, operating_point(rows))
    return rate_record("recall", recall, 4) | rate_record("recall_own", own, 4) | {"n": recall.n}


def attack_record(results: Results, spec: str) -> dict:
    """Count what a cloak does to a detector, with own clothing and random colours beside it.

    success, success_own: people hidden at 0.6 and at the detector's own threshold; masr: mean success over the
    thresholds 0.1 to 0.9; by_threshold; CONTROL, CONTROL_own; ap50, ap50_95; renamed, gone, named (`outcome_record`).
    """
    rows = results.rows(spec, LOGO)
    over_thresholds = rate(rows, np.mean([hidden(rows, t) for t in THRESHOLDS], axis=0))
    record = success_rates(rows) | rate_record("masr", over_thresholds, 4)
    record["by_threshold"] = {f"{t:g}": digits(x) for t, x in zip(THRESHOLDS, threshold_curve(rows), strict=True)}
    for control in results.controls[1:]:
        other = results.rows(spec, control)
        record |= {control: digits(share(other)), f"{control}_own": digits(share(other, operating_point(other)))}
    record |= precision_record(results, rows) | outcome_record(rows)
    return record | {"n": len(rows), "seeds": results.trainings}


def precision_record(results: Results, rows: pd.DataFrame) -> dict:
    """Compute AP50 and AP50:95, the mean of repetitions."""
    wide = average_precision(results, rows, OVERLAPS)
    return {"ap50": digits(average_precision(results, rows)), "ap50_95": digits(wide)}


def by_angle_record(results: Results, spec: str) -> dict[str, dict]:
    """Compute success at both thresholds for each azimuth (degrees)."""
    return {f"{angle:g}": success_rates(rows) for angle, rows in results.rows(spec, LOGO).groupby("angle")}


def clean_record(results: Results, spec: str) -> dict:
    """Compute recall in own clothing, average precision, and false alarms on bare backgrounds."""
    rows, bare = results.rows(spec, CLOTHING), results.rows(spec, NOBODY)
    record = recall_rates(rows) | rate_record("recall_on_body", found_rate(rows, column="score_on"), 4)
    record |= precision_record(results, rows)
    for name, threshold in (("false_alarms", THRESHOLD), ("false_alarms_own", operating_point(rows))):
        alarms = 1 - share(bare, threshold)
        record |= rate_record(name, Rate(alarms, *wilson(alarms, len(bare)), len(bare)), 4)
    return record | {"backgrounds": len(bare)}


def recall_by(results: Results, spec: str) -> dict[str, dict[str, dict]]:
    """Compute recall in own clothing by distance (m), azimuth, elevation (degrees), body and pose, by their values."""
    rows = results.rows(spec, CLOTHING)
    rows = rows.assign(stance=[stance_of(name) for name in rows["body"]])
    label = lambda value: value if isinstance(value, str) else f"{value:g}"
    return {
        way: {label(value): recall_rates(mine) for value, mine in rows.groupby(column)}
        for way, column in RECALL_BY.items()
    }


def stance_of(body: str) -> str:
    """Read a pose's kind from a body's name, without the number at its end: "walking-10" is walking."""
    return re.sub(r"[-_ .]*\d+$", "", body) or body


def control_records(results: Results, spec: str, logo: str) -> dict[str, dict]:
    """Compute success of untrained patterns beside own clothing; logo: what the logo's faces hold, by name."""
    names = {LOGO: logo}
    return {names.get(control, control): success_rates(results.rows(spec, control)) for control in results.controls}


# --- leave-one-out matrices


def transfer_record(results: Results, judged: str) -> dict:
    """Count a cell: success at 0.6, at the detector's own threshold and at 0.25, with intervals and controls."""
    rows, record = results.rows(judged, LOGO), {}
    point = operating_point(rows)
    for suffix, threshold in (("", THRESHOLD), ("_own", point), ("_025", LOW)):
        record |= rate_record(f"success{suffix}", hidden_rate(rows, threshold), 4)
        record |= {f"{name}{suffix}": digits(share(results.rows(judged, name), threshold)) for name in STANDARD}
    record |= outcome_record(rows) | {"operating_point": point, "n": len(rows), "images": len(results.trials)}
    return record | {"by_seed": [digits(value) for value in by_training(rows)]}


def transfer_means(cells: pd.DataFrame) -> dict:
    """Average the cells of one matrix: mean and worst success at each threshold, and the mean by kinship."""
    record = {}
    for suffix in ("", "_own", "_025"):
        values = cells[f"success{suffix}"].astype(float)
        record |= {f"mean{suffix}": digits(values.mean()), f"worst{suffix}": digits(values.min())}
    return record | {f"mean_{kin}": digits(cells.loc[cells["kin"] == kin, "success"].mean()) for kin in KINSHIPS}


KINSHIPS = ("sibling", "stranger")
"""What files and `--json` call a judged detector: one of the same family as a surrogate, or of none."""
