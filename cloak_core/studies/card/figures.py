"""A card's figures from the rows behind them: made once when a card is made, and again when one is checked.

The rows of a part are a table for each repetition of its training (`Results`), kept beside card.json in rows/.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path

from cloak_core.core.evaluation.results import Results, pool, read_results
from cloak_core.core.evaluation.statistics import side_record, success_record
from cloak_core.files.errors import InputError
from cloak_core.files.reading import parse_json
from cloak_core.studies import statistics_card
from cloak_core.studies.card.certainty import MEASURED, NOT_MEASURED, state, state_of_attack, whole, worn_rows
from cloak_core.studies.card.protocol import AGAINST, AREAS

ROWS = "rows"
"""Folder beside card.json."""
ROUNDING = 2e-4
"""By how much a figure may differ that is computed again: it has four digits."""


def part_of_area(area: float) -> str:
    """Name the part of an area's cloak."""
    return f"area {area:.0%}"


def rows_files(folder: Path, part: str) -> list[Path]:
    """List the files of a part's rows, one for each repetition of its training."""
    return sorted((folder / ROWS).glob(f"{file_part(part)}.[0-9]*.npz"))


def file_part(part: str) -> str:
    """Write a part's name as part of a file's name."""
    return "".join(letter if letter.isalnum() or letter in "-_=" else "-" for letter in part)


def keep_rows(folder: Path, part: str, repetitions: list[Results]) -> Results:
    """Write a part's rows beside the card, and return them as a check will read them."""
    (folder / ROWS).mkdir(exist_ok=True)
    for path in rows_files(folder, part):
        path.unlink()
    for k, results in enumerate(repetitions):
        results.save(folder / ROWS / f"{file_part(part)}.{k}.npz")
    return read_rows(folder, part)


def read_rows(folder: Path, part: str) -> Results:
    """Read a part's rows. InputError: there are none."""
    paths = rows_files(folder, part)
    if not paths:
        raise InputError(f"{folder / ROWS}: holds no rows of {part}")
    return pool([read_results(path) for path in paths])


def part_figures(part: str, results: Results, spec: str, head: dict) -> dict:
    """Compute the figures of a part. head: what the card says beside figures (`partial_gradient`, `steps` of a row)."""
    if part == "clean":
        return {
            "clean": statistics_card.clean_record(results, spec) | {"state": MEASURED},
            "recall_by": statistics_card.recall_by(results, spec),
            "controls": {
                name: row | {"state": MEASURED}
                for name, row in statistics_card.control_records(results, spec, logo="noise").items()
            },
        }
    if part == "people":
        rows = {name: results.rows(spec, name) for name in results.controls}
        return {name: success_record(results, row) | side_record(row) for name, row in rows.items()}
    record = statistics_card.attack_record(results, spec)
    if part == "circle":
        record |= {"by_angle": statistics_card.by_angle_record(results, spec)}
    against = part == "circle" or part.startswith("area ")
    area = head.get("asked")
    sure = state_of_attack(head["steps"], area, head["partial_gradient"]) if against else MEASURED
    return record | {"state": sure}


def people_states(card: dict, rows: dict[str, dict]) -> dict[str, dict]:
    """Say how sure each row of people in photographs is: the cloak made against the detector as it is on renders."""
    largest = card["white_box"][-1] if card["white_box"] else None
    return {name: row | {"state": state(largest) if name == AGAINST else MEASURED} for name, row in rows.items()}


def summary(card: dict) -> dict:
    """Compute what a card says of all its parts together."""
    black = card["black_box"]
    counted = [row for row in black["zoo"] if not row["trained_against_it"]]
    worst = max(counted, key=lambda row: (row["success_own"], row["success"]), default=None)
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


# --- again


def places(card: dict) -> Iterator[tuple[str, str, dict, dict]]:
    """List a card's parts: name, place in card.json, the figures there, and what decides how sure they are."""
    partial = {"partial_gradient": card["partial_gradient"]}
    yield "clean", "", {key: card[key] for key in ("clean", "recall_by", "controls")}, partial
    for row in card["white_box"]:
        yield part_of_area(row["asked"]), f"white_box.{100 * row['asked']:g}", row, partial | row
    if card.get("around"):
        yield "circle", "around", card["around"], partial | card["around"]
    for row in card["black_box"]["zoo"]:
        yield f"zoo {row['name']}", f"black_box.zoo.{row['name']}", row, partial
    for row in card.get("patterns") or []:
        yield f"pattern {row['name']}", f"patterns.{row['name']}", row, partial
    if card.get("photographs"):
        yield "people", "photographs.rows", card["photographs"]["rows"], partial


def differences(card: dict, folder: Path) -> Iterator[str]:
    """Compute every figure of a card again from the rows in its folder, and name those that differ.

    InputError: the rows of a part are missing, or are something else.
    """
    for part, place, record, head in places(card):
        results = read_rows(folder, part)
        if results.detectors != (card["spec"],):
            raise InputError(f"{folder / ROWS}: the rows of {part} are of {', '.join(results.detectors)}")
        fresh = part_figures(part, results, card["spec"], head)
        if part == "people":
            fresh = people_states(card, fresh)
        yield from _apart(place, _as_read(fresh), record)
    yield from _apart("", _as_read(summary(card)), card)


def _as_read(record: dict) -> dict:
    return parse_json(json.dumps(record).encode(), "figures")


def _apart(place: str, fresh: object, said: object) -> Iterator[str]:
    if isinstance(fresh, Mapping) and isinstance(said, Mapping):
        for key, value in fresh.items():
            inner = f"{place}.{key}" if place else key
            if key in said:
                yield from _apart(inner, value, said[key])
            else:
                yield f"{inner} is missing"
        return
    if isinstance(fresh, list) and isinstance(said, list) and len(fresh) == len(said):
        for k, (value, other) in enumerate(zip(fresh, said, strict=True)):
            yield from _apart(f"{place}.{k}", value, other)
        return
    numbers = all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in (fresh, said))
    if not (math.isclose(fresh, said, rel_tol=0, abs_tol=ROUNDING) if numbers else fresh == said):
        yield f"{place} is {said!r}, its rows say {fresh!r}"
