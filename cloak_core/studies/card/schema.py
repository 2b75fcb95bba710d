"""What a card says itself, place by place; all else in card.json is computed from its rows and its size.

`CARD` and `PICTURES` are schemas: tables and lists of kinds. `SAID` marks provenance, which nothing can be held
against; every other value decides what the rows have to be, or has to be that of the other cards of a leaderboard.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

from cloak_core.files.errors import InputError
from cloak_core.files.reading import is_number

MOST = 1000
"""Values in a list or table, none of which is longer in a card."""
MOST_TEXT = 4096


@dataclass(frozen=True)
class Kind:
    """One value: what it is called, and how it is known."""

    what: str
    holds: Callable[[object], bool]
    said: bool = False
    """Whether it is provenance: the word of whoever made the card."""


@dataclass(frozen=True)
class Maybe:
    """A value that may be null or missing."""

    of: object


@dataclass(frozen=True)
class Named:
    """A table with any keys."""

    of: object


def _is_text(value: object) -> bool:
    return isinstance(value, str) and len(value) <= MOST_TEXT and value.isprintable()


TEXT = Kind("a line of text", _is_text)
NAME = Kind("a name", lambda value: _is_text(value) and bool(re.fullmatch(r"[^/\\]+", value)))
FILE = Kind("the name of a picture", lambda value: _is_text(value) and bool(re.fullmatch(r"[\w-]+\.(jpg|png)", value)))
DIGEST = Kind("a SHA-256", lambda value: isinstance(value, str) and bool(re.fullmatch("[0-9a-f]{64}", value)))
FLAG = Kind("true or false", lambda value: isinstance(value, bool))
COUNT = Kind("a count", lambda value: is_number(value) and isinstance(value, int) and 0 <= value < 1 << 31)
NUMBER = Kind("a number", is_number)
SHARE = Kind("a share from 0 to 1", lambda value: is_number(value) and 0 <= value <= 1)
SAID = replace(TEXT, said=True)

BODIES = {"name": SAID, "poses": [TEXT], "outfits": COUNT, "faces": COUNT, "sha256": DIGEST}
BACKGROUNDS = {"count": COUNT, "sha256": DIGEST}
SEEN = Maybe(FLAG)
CARD = {
    "spec": TEXT,
    "size": TEXT,
    "operating_point": SHARE,
    "operating_point_assumed": FLAG,
    "differentiable": FLAG,
    "partial_gradient": TEXT,
    "cover": Maybe(TEXT),
    "made": {name: SAID for name in ("cloak", "command", "python", "torch", "numpy", "platform")}
    | {"seed": COUNT, "threads": replace(COUNT, said=True)},
    "materials": {
        "bodies": BODIES,
        "unseen": BODIES,
        "backgrounds": BACKGROUNDS,
        "unseen_backgrounds": BACKGROUNDS,
        "detectors": Named(DIGEST),
        "shown_people": Maybe({"count": COUNT, "photographs": COUNT, "sha256": DIGEST}),
    },
    "left_patterns": [NAME],
    "white_box": [{"area": SHARE, "faces": COUNT}],
    "black_box": {
        "zoo": [
            {
                "name": NAME,
                "trained_against_it": FLAG,
                "unseen": {"bodies": SEEN, "backgrounds": SEEN},
                "area": SHARE,
            }
        ]
    },
    "patterns": [{"name": NAME}],
    "photographs": Maybe({"left_out": Named(COUNT)}),
    "seconds": replace(NUMBER, said=True),
}
"""What card.json says itself."""

BOX = Kind("a box", lambda value: isinstance(value, list) and len(value) == 5 and all(map(is_number, value)))
SHOT = {"file": FILE, "boxes": Named([BOX]), "scores": Named(SHARE)}
TRIAL = {"trial": COUNT, "body": TEXT, "angle": NUMBER, "distance": NUMBER, "background": TEXT}
PICTURES = {
    "missed": [TRIAL | {"clothing": SHOT}],
    "alarms": [{"background": TEXT, "bare": SHOT}],
    "hidden": Named([TRIAL | {"clothing": SHOT, "logo": SHOT}]),
    "cloaks": [{"part": NAME, "front": Maybe(FILE), "back": Maybe(FILE)}],
}
"""What pictures.json says."""


def take(schema: object, value: object, place: str) -> object:
    """Copy what a schema names, and nothing else.

    place: what errors begin with, "card.json: ". InputError: the place of what is missing or of another kind.
    """
    if isinstance(schema, Maybe):
        return None if value is None else take(schema.of, value, place)
    if isinstance(schema, Kind):
        if not schema.holds(value):
            raise InputError(f"{place} is {value!r:.80}, not {schema.what}")
        return value
    kind = list if isinstance(schema, list) else dict
    if not isinstance(value, kind) or len(value) > MOST:
        raise InputError(f"{place} is {value!r:.80}, not a {'list' if kind is list else 'table'}")
    if isinstance(schema, list):
        return [take(schema[0], inner, inside(place, k)) for k, inner in enumerate(value)]
    if isinstance(schema, Named):
        return {take(TEXT, key, place): take(schema.of, inner, inside(place, key)) for key, inner in value.items()}
    for key, inner in schema.items():
        if key not in value and not isinstance(inner, Maybe):
            raise InputError(f"{inside(place, key)} is missing")
    return {key: take(inner, value[key], inside(place, key)) for key, inner in schema.items() if key in value}


def inside(place: str, key: object) -> str:
    """Name a place in a table or list: "clean" and "n" are "clean.n"."""
    return f"{place}{'.' if place and not place.endswith(' ') else ''}{key}"
