"""A whole card from what it says itself and its rows: made so when it is measured, and again when it is checked."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluate import MEASUREMENT_VERSION
from cloak_core.core.evaluation.results import Results, pool
from cloak_core.core.evaluation.statistics import side_record, success_record
from cloak_core.files.errors import InputError
from cloak_core.files.reading import parse_json
from cloak_core.studies import statistics_card
from cloak_core.studies.card.certainty import MEASURED, NOT_MEASURED, state, state_of_attack, whole, worn_rows
from cloak_core.studies.card.parts import part_of_area
from cloak_core.studies.card.protocol import AGAINST, AREAS, FORMAT, VERSION, Size
from cloak_core.studies.card.schema import CARD, inside
from cloak_core.studies.training_store import TRAINING_VERSION
from cloak_core.zoo.entry import MARK

ROUNDING = 2e-4
"""By how much a figure may differ that is computed again: it has four digits."""
DETECTOR = ("operating_point", "operating_point_assumed", "differentiable", "partial_gradient")
"""What a card says of its detector beside its spec."""
VERSIONS = {"training": TRAINING_VERSION, "measurement": MEASUREMENT_VERSION}


def card_of(told: Mapping, size: Size, rows: Mapping[str, Sequence[Results]]) -> dict:
    """Make a card. told: what it says itself (`schema.CARD`); rows: by part, a table for each repetition.

    InputError: people in photographs do not wear the strongest of the zoo's cloaks.
    """
    spec, tables = told["spec"], {part: pool(repetitions) for part, repetitions in rows.items()}

    def attack(part: str) -> dict:
        return statistics_card.attack_record(tables[part], spec)

    def white_box(part: str, steps: int, area: float | None = None) -> dict:
        return {"steps": steps} | attack(part) | {"state": state_of_attack(steps, area, told["partial_gradient"])}

    areas = size.areas if told["differentiable"] else ()
    sure = {"state": MEASURED}
    card = fixed(size) | {key: told[key] for key in CARD if key in told} | clean_figures(tables["clean"], spec)
    card["white_box"] = [
        {"asked": area} | row | white_box(part_of_area(area), size.steps, area)
        for area, row in zip(areas, told["white_box"], strict=True)
    ]
    card["around"] = None
    if "circle" in tables:
        by_angle = statistics_card.by_angle_record(tables["circle"], spec)
        card["around"] = white_box("circle", 2 * size.steps) | {"by_angle": by_angle}
    card["black_box"] = {"zoo": [row | attack(f"zoo {row['name']}") | sure for row in told["black_box"]["zoo"]]}
    card["patterns"] = [row | attack(f"pattern {row['name']}") | sure for row in told["patterns"]]
    if "people" in tables:
        card["photographs"] |= photograph_figures(card, tables["people"])
    return parse_json(json.dumps(card | summary(card)).encode(), "figures")


def fixed(size: Size) -> dict:
    """Tell what all cards of a size say, as JSON has it."""
    counts = asdict(size) | {"areas": list(size.areas)}
    return {"format": FORMAT, "protocol": VERSION, "size": size.name, "versions": VERSIONS, "counts": counts}


def detector_facts(detector: Detector) -> dict:
    """Tell `DETECTOR` of a detector at hand."""
    return {name: getattr(detector, name) for name in DETECTOR}


def clean_figures(results: Results, spec: str) -> dict:
    """Compute what a detector finds without an attack, and beside untrained patterns."""
    controls = statistics_card.control_records(results, spec, logo="noise")
    return {
        "clean": statistics_card.clean_record(results, spec) | {"state": MEASURED},
        "recall_by": statistics_card.recall_by(results, spec),
        "controls": {name: row | {"state": MEASURED} for name, row in controls.items()},
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


def summary(card: dict) -> dict:
    """Compute what a card says of all its parts together."""
    black = card["black_box"]
    counted = [row for row in black["zoo"] if not row["trained_against_it"]]
    worst = others_strongest(black["zoo"])
    most = {key: max((row[key] for row in counted), default=None) for key in ("success", "success_own")}
    around = card.get("around")
    return {
        "circle": around["success"] if around else None,
        "black_box": {"zoo": black["zoo"], "counted": len(counted), "worst": worst and worst["name"]}
        | most
        | {"state": MEASURED if counted else NOT_MEASURED},
        "state": whole(card),
        "not_tested": untested(card),
    }


def others_strongest(zoo: Sequence[dict]) -> dict | None:
    """Choose the cloak made against other detectors that hides most people, at the own threshold and then at 0.6."""
    counted = [row for row in zoo if not row["trained_against_it"]]
    return max(counted, key=lambda row: (row["success_own"], row["success"]), default=None)


def untested(card: dict) -> list[str]:
    """Say what this card did not measure, for reasons of this detector, its size, or the call."""
    said = []
    if not card["differentiable"]:
        said.append(
            "No white-box attack: the detector gives no gradients. An attacker who has its weights in another "
            "form may do far better than the cloaks shown here."
        )
    else:
        made = [row["asked"] for row in card["white_box"]]
        missing = [f"{area:.0%} of the body".replace("%", " %") for area in AREAS if area not in made]
        missing += [] if card.get("around") else ["the full circle"]
        if missing:
            said.append(f"Cloaks made against it for {', '.join(missing)}: not made in a card of size {card['size']}.")
        if card["partial_gradient"]:
            said.append(f"The gradient that the attack follows is not all of the answer's: {card['partial_gradient']}.")
    if not any(not row["trained_against_it"] for row in card["black_box"]["zoo"]):
        some = bool(card["black_box"]["zoo"])
        why = "those there are were made against it" if some else "the zoo holds none for this scene's bodies"
        said.append(f"No cloak made against other detectors: {why}.")
    if not card.get("photographs"):
        said.append("People in photographs: none were given (--people).")
    elif card["photographs"]["people"] < card["counts"]["people"]:
        said.append(
            f"{card['photographs']['people']} people in photographs, of {card['counts']['people']} at this size."
        )
    if not card.get("patterns") and not any("@" in name for name in worn_rows(card)):
        said.append("Published patterns: none were given (--patterns).")
    return said + [f"The pattern {name}: this size has {card['counts']['patterns']}." for name in card["left_patterns"]]


def differences(fresh: object, said: object, place: str = "") -> Iterator[str]:
    """List the places where a card differs from the one that was made anew, both as JSON has them."""
    if isinstance(fresh, dict) and isinstance(said, dict):
        for key in dict.fromkeys([*fresh, *said]):
            if key not in said or key not in fresh:
                yield f"{inside(place, key)} is {'missing' if key in fresh else 'no part of a card'}"
            else:
                yield from differences(fresh[key], said[key], inside(place, key))
    elif isinstance(fresh, list) and isinstance(said, list) and len(fresh) == len(said):
        for k, (value, other) in enumerate(zip(fresh, said, strict=True)):
            yield from differences(value, other, inside(place, row_name(value, k)))
    else:
        numbers = all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in (fresh, said))
        if not (math.isclose(fresh, said, rel_tol=0, abs_tol=ROUNDING) if numbers else fresh == said):
            yield f"{place} is {said!r:.80}; computed anew it is {fresh!r:.80}"


def row_name(row: object, index: int) -> str:
    """Name a row of a list: by the share of the body that was asked for in per cent, its name, or its index."""
    if isinstance(row, dict) and "asked" in row:
        return f"{100 * row['asked']:g}"
    return str(row["name"]) if isinstance(row, dict) and "name" in row else str(index)
