"""What a JSON file beside a network's file says of it: class names, the person, layout, confidence, pixels."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cloak_core.detectors.pixels import PixelFormat
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json

NAMES = ("classes", "names", "class_names", "labels")
CONFIDENCE = ("confidence", "conf", "conf_thres", "score_threshold")
_log = logging.getLogger("cloak")


@dataclass(frozen=True)
class Description:
    """What was said of a network; None where nothing was."""

    names: tuple[str, ...] | None = None
    person: int | None = None
    """Index of the class to look for."""
    layout: str | None = None
    """Of its outputs."""
    confidence: float | None = None
    """The score above which it is said to report a box."""
    pixels: PixelFormat | None = None


def read_description(path: Path) -> Description:
    """Read NAME.json beside NAME.SUFFIX, as far as it is understood; nothing where there is none.

    Understood: `classes` (or names, class_names, labels: a list, or {"0": NAME}), `person_class` (an index or a name),
    `confidence` in (0, 1), `output.layout`, and `input` with `channels` (RGB or BGR), `range` and `normalisation`.
    """
    beside = path.with_suffix(".json")
    if beside == path or not beside.is_file():
        return Description()
    try:
        said = read_json(beside)
    except InputError as error:  # perhaps another program's, about something else
        _log.warning("%s; nothing of it is used", error)
        return Description()
    names = next((found for key in NAMES if (found := names_of(said.get(key)))), None)
    outputs, inputs = (part if isinstance(part, Mapping) else {} for part in (said.get("output"), said.get("input")))
    layout = outputs.get("layout", said.get("layout"))
    return Description(
        names,
        _person(said.get("person_class"), names),
        layout if isinstance(layout, str) else None,
        confidence_of(said),
        _pixels(inputs),
    )


def names_of(said: object) -> tuple[str, ...] | None:
    """Read class names from a list of words, or from a word for each number; None where it is neither."""
    if isinstance(said, Mapping):
        said = [said.get(index, said.get(str(index))) for index in range(len(said))]
    words = isinstance(said, list | tuple) and said and all(isinstance(name, str) for name in said)
    return tuple(said) if words else None


def confidence_of(said: Mapping[str, object]) -> float | None:
    """Find the first usual name under which a confidence in (0, 1) is said, as a number or as text."""
    for key in CONFIDENCE:
        with contextlib.suppress(KeyError, TypeError, ValueError):
            if 0 < (value := float(said[key])) < 1:
                return value
    return None


def _person(said: object, names: tuple[str, ...] | None) -> int | None:
    if isinstance(said, str) and names is not None and said in names:
        return names.index(said)
    return said if isinstance(said, int) and not isinstance(said, bool) and said >= 0 else None


def _pixels(said: Mapping) -> PixelFormat | None:
    """Read RGB or BGR, 0..1 or 0..255; None where anything else is said."""
    channels, scale = str(said.get("channels", "")).upper(), str(said.get("range", "")).replace(" ", "")
    whites = {"[0,1]": 1.0, "0..1": 1.0, "[0,255]": 255.0, "0..255": 255.0}
    plain = str(said.get("normalisation", "none")).startswith(("none", "folded"))
    if channels not in ("RGB", "BGR") or scale not in whites or not plain:
        return None
    return PixelFormat(bgr=channels == "BGR", range=whites[scale])
