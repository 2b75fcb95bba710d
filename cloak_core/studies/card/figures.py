"""A whole card from what it says itself and its rows: made so when it is measured, and again when it is checked.

Figures are plain values of four digits. One is added here; `leaderboard` says where it is shown.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict

import numpy as np
import pandas as pd

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluate import MEASUREMENT_VERSION
from cloak_core.core.evaluation import CLOTHING, LOGO
from cloak_core.core.evaluation.intervals import Rate, wilson
from cloak_core.core.evaluation.precision import OVERLAPS, average_precision
from cloak_core.core.evaluation.results import BOX_COLUMNS, CORNERS, NOBODY, TRUE_BOX, Results, make_results, pool
from cloak_core.core.evaluation.statistics import (
    THRESHOLDS,
    digits,
    found_rate,
    hidden_rate,
    operating_point,
    outcome_record,
    published_rates,
    rate_record,
    side_record,
    success_rate,
    success_record,
    threshold_curve,
)
from cloak_core.files.errors import InputError
from cloak_core.files.reading import parse_json
from cloak_core.studies.card.protocol import (
    AGAINST,
    AREAS,
    FORMAT,
    GREY_HEAD,
    HEADS,
    UNTRAINED,
    VERSION,
    Part,
    Size,
    part_of_area,
    parts_of,
)
from cloak_core.studies.card.words import (
    MEASURED,
    NOT_MEASURED,
    others_strongest,
    state,
    whole,
    worn_rows,
)
from cloak_core.studies.training_store import TRAINING_VERSION
from cloak_core.zoo.entry import MARK

ROUNDING = 2e-4
"""By how much a figure may differ that is computed again: it has four digits."""
DETECTOR = ("operating_point", "operating_point_assumed", "differentiable", "partial_gradient")
"""What a card says of its detector beside its spec."""
VERSIONS = {"training": TRAINING_VERSION, "measurement": MEASUREMENT_VERSION}
RECALL_BY = {"distance": "distance", "azimuth": "angle", "elevation": "elevation", "body": "body", "pose": "stance"}
"""By what a card tells recall apart, and the column of the table."""


def detector_facts(detector: Detector) -> dict:
    """Tell `DETECTOR` of a detector at hand."""
    return {name: getattr(detector, name) for name in DETECTOR}


def fixed(size: Size) -> dict:
    """Tell what all cards of a size say, as JSON has it."""
    counts = asdict(size) | {"areas": list(size.areas)}
    return {"format": FORMAT, "protocol": VERSION, "size": size.name, "versions": VERSIONS, "counts": counts}


def card_of(stated: Mapping, size: Size, rows: Mapping[str, Sequence[Results]]) -> dict:
    """Make a card. stated: what it says itself (`entry.CARD`); rows: by part, a table for each repetition.

    InputError: people in photographs do not wear the strongest of the zoo's cloaks.
    """
    spec, tables = stated["spec"], {part: pool(repetitions) for part, repetitions in rows.items()}
    attacks = {}
    for part in parts_of(stated, size):
        if part.name not in ("clean", "people"):
            steps = {"steps": part.steps} if part.steps else {}
            record = attack_record(tables[part.name], spec)
            attacks[part.name] = steps | record | {"state": part.state(stated["partial_gradient"])}
    card = fixed(size) | dict(stated) | {"photographs": stated.get("photographs")}
    card |= clean_figures(tables["clean"], spec) | {"around": None}
    areas = zip(size.areas if stated["differentiable"] else (), stated["white_box"], strict=True)
    card["white_box"] = [{"asked": area} | row | attacks[part_of_area(area)] for area, row in areas]
    if "circle" in tables:
        angles = tables["circle"].rows(spec, LOGO).groupby("angle")
        by_angle = {f"{angle:g}": success_rates(seen) for angle, seen in angles}
        card["around"] = attacks["circle"] | {"by_angle": by_angle}
    card["black_box"] = {"zoo": [row | attacks[f"zoo {row['name']}"] for row in stated["black_box"]["zoo"]]}
    card["patterns"] = [row | attacks[f"pattern {row['name']}"] for row in stated["patterns"]]
    if "people" in tables:
        card["photographs"] |= photograph_figures(card, tables["people"])
    return parse_json(json.dumps(card | summary(card)).encode(), "figures")


# --- before anything is measured


def expected_card(stated: Mapping, size: Size, worn: Sequence[str]) -> dict:
    """Make the card of a call from rows in which a detector finds everybody in own clothing, and nobody else.

    stated: what the card will say itself (`entry.CARD`); worn: the patterns of people in photographs, by name.
    """
    zoo = [MARK + row["name"] for row in stated["black_box"]["zoo"] if not row["trained_against_it"]]
    shown = (*[AGAINST] * stated["differentiable"], *zoo[:1], *worn, *HEADS, GREY_HEAD, *UNTRAINED)
    card = card_of(stated, size, {part.name: [_expected_rows(part, stated, shown)] for part in parts_of(stated, size)})
    if card["photographs"] and zoo:
        rows = card["photographs"]["rows"]
        rows |= dict.fromkeys(zoo, rows[zoo[0]])  # which of them people wear is known when all are measured
    return {key: value for key, value in card.items() if value is not None}


def _expected_rows(part: Part, stated: Mapping, shown: Sequence[str]) -> Results:
    """Make up the rows of a part. shown: what people in photographs wear."""
    if part.name == "people":
        controls, bodies = shown, ("front", "side", "back")
        trials = pd.DataFrame({"pose": range(3), "background": 0, "photograph": "", "seen_from": bodies})
    else:
        bodies = stated["materials"]["unseen"]["poses"]
        controls, trials = part.drawn(stated["materials"]["unseen"], 1)
    trials = trials.assign(**dict.fromkeys(TRUE_BOX, 0.0))
    score = np.zeros((1, len(controls), len(trials)), np.float32)
    score[:, controls.index(CLOTHING)] = 1
    boxes = {name: np.zeros(0, kind) for name, kind in BOX_COLUMNS.items()} | {name: np.zeros(0) for name in CORNERS}
    bare = np.zeros((1, 1), np.float32)
    names = {"body_names": bodies, "background_names": ("",), "other_name": np.full(score.shape, "other")}
    own = {stated["spec"]: stated["operating_point"]}
    return make_results(own, controls, trials, score, score, bare, boxes, other=np.ones_like(score), **names)


# --- of rows


def success_rates(rows: pd.DataFrame) -> dict:
    """Compute success at 0.6, at the detector's own threshold (`_own`), at 0.5 (`_05`), and mASR, with intervals."""
    own = hidden_rate(rows, operating_point(rows))
    record = rate_record("success", hidden_rate(rows), 4) | rate_record("success_own", own, 4)
    return record | published_rates(rows, 4)


def recall_rates(rows: pd.DataFrame) -> dict:
    """Compute recall at 0.6 and (`_own`) at the detector's own threshold, each with its interval."""
    recall, own = found_rate(rows), found_rate(rows, operating_point(rows))
    return rate_record("recall", recall, 4) | rate_record("recall_own", own, 4) | {"n": recall.n}


def attack_record(results: Results, spec: str) -> dict:
    """Count what a cloak does to a detector, with own clothing and random colours beside it.

    success, success_own, success_05, masr: see `success_rates`; by_threshold;
    CONTROL, CONTROL_own; ap50, ap50_95; renamed, gone, named (`outcome_record`).
    """
    rows = results.rows(spec, LOGO)
    record = success_rates(rows)
    record["by_threshold"] = {f"{t:g}": digits(x) for t, x in zip(THRESHOLDS, threshold_curve(rows), strict=True)}
    for control in results.controls[1:]:
        other = results.rows(spec, control)
        record[control] = digits(success_rate(other))
        record[f"{control}_own"] = digits(success_rate(other, operating_point(other)))
    record |= precision(results, rows) | outcome_record(rows)
    return record | {"n": len(rows), "seeds": results.trainings}


def precision(results: Results, rows: pd.DataFrame) -> dict:
    """Compute AP50 and AP50:95, the mean of repetitions."""
    wide = average_precision(results, rows, OVERLAPS)
    return {"ap50": digits(average_precision(results, rows)), "ap50_95": digits(wide)}


def clean_figures(results: Results, spec: str) -> dict:
    """Compute what a detector finds in own clothing, its false alarms, and success of untrained patterns beside it.

    Recall is told by distance (m), azimuth, elevation (degrees), body and pose, by their values.
    """
    rows, bare = results.rows(spec, CLOTHING), results.rows(spec, NOBODY)
    clean = recall_rates(rows) | rate_record("recall_on_body", found_rate(rows, column="score_on"), 4)
    clean |= precision(results, rows)
    for name, threshold in (("false_alarms", THRESHOLD), ("false_alarms_own", operating_point(rows))):
        alarms = 1 - success_rate(bare, threshold)
        clean |= rate_record(name, Rate(alarms, *wilson(alarms, len(bare)), len(bare)), 4)
    recall_by = {}
    # A pose's kind is its body's name without the number at its end: "walking-10" is walking.
    rows = rows.assign(stance=[re.sub(r"[-_ .]*\d+$", "", name) or name for name in rows["body"]])
    for way, column in RECALL_BY.items():
        groups = [(value if isinstance(value, str) else f"{value:g}", seen) for value, seen in rows.groupby(column)]
        recall_by[way] = {label: recall_rates(seen) for label, seen in groups}
    # What stands for a cloak is noise.
    named = {"noise" if name == LOGO else name: results.rows(spec, name) for name in results.controls}
    return {
        "clean": clean | {"backgrounds": len(bare), "state": MEASURED},
        "recall_by": recall_by,
        "controls": {name: success_rates(rows) | {"state": MEASURED} for name, rows in named.items()},
    }


def photograph_figures(card: dict, results: Results) -> dict:
    """Count people in photographs by what they wear; the cloak made against the detector is as sure as on renders."""
    strange, largest = others_strongest(card["black_box"]["zoo"]), (card["white_box"] or [None])[-1]
    worn = [name for name in results.controls if name.startswith(MARK) and "@" not in name]
    if worn != ([MARK + strange["name"]] if strange else []):
        raise InputError(f"rows of people: they wear {worn}, not the strongest of the zoo's cloaks")
    figures = {}
    for name in results.controls:
        rows = results.rows(card["spec"], name)
        sure = state(largest) if name == AGAINST else MEASURED
        figures[name] = success_record(results, rows) | side_record(rows) | {"state": sure}
    return {"people": len(results.trials), "rows": figures}


# --- of a card


def summary(card: dict) -> dict:
    """Compute what a card says of all its parts together."""
    zoo = card["black_box"]["zoo"]
    counted = [row for row in zoo if not row["trained_against_it"]]
    worst = others_strongest(zoo)
    most = {key: max((row[key] for row in counted), default=None) for key in ("success", "success_own")}
    black_box = {"zoo": zoo, "counted": len(counted), "worst": worst and worst["name"]} | most
    return {
        "circle": card["around"]["success"] if card["around"] else None,
        "black_box": black_box | {"state": MEASURED if counted else NOT_MEASURED},
        "state": whole(card),
        "not_tested": untested(card),
    }


def untested(card: dict) -> list[str]:
    """Say what this card did not measure, for reasons of this detector, its size, or the call."""
    sentences = []
    made = [row["asked"] for row in card["white_box"]]
    missing = [f"{100 * area:.0f} % of the body" for area in AREAS if area not in made]
    missing += [] if card["around"] else ["the full circle"]
    if not card["differentiable"]:
        sentences.append(
            "No white-box attack: the detector gives no gradients. An attacker who has its weights in another "
            "form may do far better than the cloaks shown here."
        )
    elif missing:
        asked = ", ".join(missing)
        sentences.append(f"Cloaks made against it for {asked}: not made in a card of size {card['size']}.")
    if card["differentiable"] and card["partial_gradient"]:
        sentences.append(
            f"The gradient that the attack follows is not all of the answer's: {card['partial_gradient']}."
        )
    zoo, photographs, counts = card["black_box"]["zoo"], card["photographs"], card["counts"]
    if all(row["trained_against_it"] for row in zoo):
        why = "those there are were made against it" if zoo else "the zoo holds none for this scene's bodies"
        sentences.append(f"No cloak made against other detectors: {why}.")
    if not photographs:
        sentences.append("People in photographs: none were given (--people).")
    elif photographs["people"] < counts["people"]:
        sentences.append(f"{photographs['people']} people in photographs, of {counts['people']} at this size.")
    if not card["patterns"] and not any("@" in name for name in worn_rows(card)):
        sentences.append("Published patterns: none were given (--patterns).")
    return sentences + [f"The pattern {name}: this size has {counts['patterns']}." for name in card["left_patterns"]]


def differences(fresh: object, stated: object, place: str = "") -> Iterator[str]:
    """List the places where a card differs from the one that was made anew, both as JSON has them."""
    if isinstance(fresh, dict) and isinstance(stated, dict):
        for key in dict.fromkeys([*fresh, *stated]):
            if key not in stated or key not in fresh:
                yield f"{inside(place, key)} is {'missing' if key in fresh else 'no part of a card'}"
            else:
                yield from differences(fresh[key], stated[key], inside(place, key))
    elif isinstance(fresh, list) and isinstance(stated, list) and len(fresh) == len(stated):
        for k, (value, other) in enumerate(zip(fresh, stated, strict=True)):
            yield from differences(value, other, inside(place, row_name(value, k)))
    else:
        numbers = all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in (fresh, stated))
        if not (math.isclose(fresh, stated, rel_tol=0, abs_tol=ROUNDING) if numbers else fresh == stated):
            yield f"{place} is {stated!r:.80}; computed anew it is {fresh!r:.80}"


def inside(place: str, key: object) -> str:
    """Name a place in a table or list: "clean" and "n" are "clean.n"."""
    return f"{place}.{key}" if place else str(key)


def row_name(row: object, index: int) -> str:
    """Name a row of a list: by the share of the body that was asked for in per cent, its name, or its index."""
    if isinstance(row, dict) and "asked" in row:
        return f"{100 * row['asked']:g}"
    return str(row["name"]) if isinstance(row, dict) and "name" in row else str(index)
