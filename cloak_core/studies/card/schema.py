"""What a card says itself, place by place; all else in card.json is computed from its rows and its size.

`CARD` and `PICTURES` are shapes (`files.shapes`). Provenance (`made`, names of bodies, seconds) can be held against
nothing; every other value decides what the rows have to be, or has to be that of the other cards of a leaderboard.
"""

from __future__ import annotations

import re

from cloak_core.files.reading import is_number
from cloak_core.files.shapes import FLAG, NOTHING, NUMBER, SHARE, Kind, Shape, check_shape

MOST_TEXT = 4096


def _is_text(value: object) -> bool:
    return isinstance(value, str) and len(value) <= MOST_TEXT and value.isprintable()


TEXT = Kind("a line of text", _is_text)
NAME = Kind("a name", lambda value: _is_text(value) and bool(re.fullmatch(r"[^/\\]+", value)))
FILE = Kind("the name of a picture", lambda value: _is_text(value) and bool(re.fullmatch(r"[\w-]+\.(jpg|png)", value)))
DIGEST = Kind("a SHA-256", lambda value: isinstance(value, str) and bool(re.fullmatch("[0-9a-f]{64}", value)))
COUNT = Kind("a count", lambda value: is_number(value) and isinstance(value, int) and 0 <= value < 1 << 31)
BOX = Kind("a box", lambda value: isinstance(value, list) and len(value) == 5 and all(map(is_number, value)))

BODIES = {"name": TEXT, "poses": [TEXT], "outfits": COUNT, "faces": COUNT, "sha256": DIGEST}
BACKGROUNDS = {"count": COUNT, "sha256": DIGEST}
UNSEEN = {"bodies?": FLAG | NOTHING, "backgrounds?": FLAG | NOTHING}
CARD = {
    "spec": TEXT,
    "size": TEXT,
    "operating_point": SHARE,
    "operating_point_assumed": FLAG,
    "differentiable": FLAG,
    "partial_gradient": TEXT,
    "cover?": TEXT,
    "made": dict.fromkeys(("cloak", "command", "python", "torch", "numpy", "platform"), TEXT)
    | {"seed": COUNT, "threads": COUNT},
    "materials": {
        "bodies": BODIES,
        "unseen": BODIES,
        "backgrounds": BACKGROUNDS,
        "unseen_backgrounds": BACKGROUNDS,
        "detectors": {"*": DIGEST},
        "shown_people?": {"count": COUNT, "photographs": COUNT, "sha256": DIGEST},
    },
    "left_patterns": [NAME],
    "white_box": [{"area": SHARE, "faces": COUNT}],
    "black_box": {"zoo": [{"name": NAME, "trained_against_it": FLAG, "unseen": UNSEEN, "area": SHARE}]},
    "patterns": [{"name": NAME}],
    "photographs?": {"left_out": {"*": COUNT}},
    "seconds": NUMBER,
}
"""What card.json says itself."""

SHOT = {"file": FILE, "boxes": {"*": [BOX]}, "scores": {"*": SHARE}}
TRIAL = {"trial": COUNT, "body": TEXT, "angle": NUMBER, "distance": NUMBER, "background": TEXT}
PICTURES = {
    "missed": [TRIAL | {"clothing": SHOT}],
    "alarms": [{"background": TEXT, "bare": SHOT}],
    "hidden": {"*": [TRIAL | {"clothing": SHOT, "logo": SHOT}]},
    "cloaks": [{"part": NAME, "front?": FILE, "back?": FILE}],
}
"""What pictures.json says."""


def take(shape: Shape, record: dict, path: str) -> dict:
    """Copy what a shape names of a record, and nothing else; null is as good as a missing value.

    InputError: `path`, and the place of what is missing or of another kind.
    """
    told = {key: value for key, value in record.items() if value is not None}
    check_shape(told, shape, path)
    return _named(shape, told)


def _named(shape: Shape, value: object) -> object:
    """Copy what a shape names of a value that fits it."""
    if isinstance(shape, list):
        return [_named(shape[0], inner) for inner in value]
    if not isinstance(shape, dict):
        return value
    shapes = {key.removesuffix("?"): inner for key, inner in shape.items()}
    if "*" in shape:
        return {key: _named(shape["*"], inner) for key, inner in value.items()}
    return {key: _named(inner, value[key]) for key, inner in shapes.items() if key in value}


def inside(place: str, key: object) -> str:
    """Name a place in a table or list: "clean" and "n" are "clean.n"."""
    return f"{place}.{key}" if place else str(key)
