"""Bounds on a card's figures, for CI: which of them are broken, in words and as a JUnit file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from cloak_core.files.errors import InputError, one_line, suggestion
from cloak_core.files.reading import is_number, read_toml
from cloak_core.files.writing import write_text
from cloak_core.studies.card.figures import inside, row_name
from cloak_core.studies.card.words import AT_LEAST, name_of

SIDES = ("min", "max")


@dataclass(frozen=True)
class Bound:
    """The least or the most that a figure may be."""

    figure: str
    """Its place in card.json, joined by dots: "clean.recall_own", "white_box.20.success_own" (20 % of the body)."""
    side: str
    value: float

    def __str__(self) -> str:
        return f"{self.figure} {'>=' if self.side == 'min' else '<='} {self.value:g}"


def read_gate(path: Path) -> list[Bound]:
    """Read the tables [min] and [max] of a TOML file. InputError: anything else in it, or nothing."""
    tables = read_toml(path)
    if set(tables) - set(SIDES) or not all(isinstance(table, dict) for table in tables.values()):
        raise InputError(f"{path}: expected the tables [min] and [max]; found {', '.join(tables)}")
    bounds = [(figure, side, value) for side, table in tables.items() for figure, value in flat(table)]
    for figure, side, value in bounds:
        if not is_number(value):
            raise InputError(f"{path}: {side} {figure} is {value!r}, not a number")
    if not bounds:
        raise InputError(f"{path}: holds no bound; expected the tables [min] and [max]")
    return [Bound(figure, side, float(value)) for figure, side, value in bounds]


def require_measured(path: Path, bounds: Sequence[Bound], card: dict) -> None:
    """Require that a card, which may be the expected one, has the figures of a gate. InputError: one that is none."""

    def unnamed(place: str) -> str:
        # Which class a person may be renamed to, nobody knows beforehand.
        return re.sub(r"\.(named|named_own)\..+", r".\1", place)

    known = {unnamed(place) for place, value in flat(card) if value is None or is_number(value)}
    for bound in bounds:
        if unnamed(bound.figure) not in known:
            parts = [f"size {card['size']}", *["no white box"] * (not card["white_box"])]
            parts += ["no --people"] * (card.get("photographs") is None)
            what = f"figure of this card ({', '.join(parts)})"
            raise InputError(f"{path}: {bound.side} {bound.figure}: no {what}{suggestion(bound.figure, known)}")


def check(card: dict, bounds: list[Bound]) -> dict[Bound, str]:
    """Say of each bound how the card breaks it, "" where it is kept.

    A figure that was not measured breaks its bound, and so does one that may be at most so much where it is only known
    to be at least so much.
    """
    figures, problems = dict(flat(card)), {}
    unsure = [place.removesuffix("state") for place, value in figures.items() if value == AT_LEAST and "." in place]
    unsure += ["circle"] if "around." in unsure else []  # the same figure once more
    for bound in bounds:
        value = figures.get(bound.figure)
        if not is_number(value):
            kept, measured = False, "was not measured"
        elif bound.side == "max" and value <= bound.value and bound.figure.startswith(tuple(unsure)):
            kept, measured = False, f"is at least {value:g}"
        else:
            kept, measured = value >= bound.value if bound.side == "min" else value <= bound.value, f"is {value:g}"
        problems[bound] = "" if kept else f"{name_of(card)}: {bound.figure} {measured}; the gate asks for {bound}"
    return problems


def write_junit(path: Path, checked: Mapping[str, Mapping[Bound, str]]) -> None:
    """Write what `check` said of each detector as JUnit XML: a suite for each detector, a case for each bound.

    Control characters, which XML has no way to write, are written out as \\x1b.
    """
    root = ElementTree.Element("testsuites", name="cloak assess")
    for name, by_bound in checked.items():
        counts = {"tests": str(len(by_bound)), "failures": str(sum(map(bool, by_bound.values())))}
        suite = ElementTree.SubElement(root, "testsuite", name=one_line(name), **counts)
        for bound, words in by_bound.items():
            case = ElementTree.SubElement(suite, "testcase", classname=one_line(name), name=one_line(str(bound)))
            if words:
                ElementTree.SubElement(case, "failure", message=one_line(words))
    ElementTree.indent(root)
    write_text(path, ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n")


def flat(value: object, place: str = "") -> Iterator[tuple[str, object]]:
    """Walk through nested tables and lists: (place joined by dots, value).

    Rows of a list go by their name, or the share of the body that was asked for in per cent, or their index.
    """
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = ((row_name(row, k), row) for k, row in enumerate(value))
    else:
        yield place, value
        return
    for key, inner in items:
        yield from flat(inner, inside(place, key))
