"""What is said of a network outside its weights: class lists, which index is the person, and a JSON file beside it."""

from __future__ import annotations

import ast
import contextlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cloak_core.detectors.pixels import PixelFormat
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json, read_text

# fmt: off
COCO = (
    "person", "bicycle", "car", "motorbike", "aeroplane", "bus", "train", "truck", "boat", "traffic light",
    "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog", "horse", "sheep", "cow", "elephant",
    "bear", "zebra", "giraffe", "backpack", "umbrella", "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard",
    "sports ball", "kite", "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket", "bottle",
    "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich", "orange", "broccoli",
    "carrot", "hot dog", "pizza", "donut", "cake", "chair", "sofa", "pottedplant", "bed", "diningtable", "toilet",
    "tvmonitor", "laptop", "mouse", "remote", "keyboard", "cell phone", "microwave", "oven", "toaster", "sink",
    "refrigerator", "book", "clock", "vase", "scissors", "teddy bear", "hair drier", "toothbrush",
)
"""The 80 COCO classes in Darknet's order and spelling."""

_UNUSED_IDS = (12, 26, 29, 30, 45, 66, 68, 69, 71, 83)
"""Of COCO's own numbers 1 to 90, those of no class."""
_used = iter(COCO)
COCO_IDS = ("nothing", *("unused" if number in _UNUSED_IDS else next(_used) for number in range(1, 91)))
"""COCO's names by its own numbers, 0 to 90."""

VOC = (
    "aeroplane", "bicycle", "bird", "boat", "bottle", "bus", "car", "cat", "chair", "cow", "diningtable", "dog",
    "horse", "motorbike", "person", "pottedplant", "sheep", "sofa", "train", "tvmonitor",
)
"""The 20 Pascal VOC classes in Darknet's order."""
# fmt: on


def person_index(names: Sequence[str] | None, person_class: str, count: int, source: str) -> int:
    """Find the index of the person class among `count` classes, by name or by index.

    `source` names the detector in the InputError raised when there is no such class.
    """
    wanted = person_class.strip().lower()
    lowered = [name.strip().lower() for name in names or ()]
    if wanted in lowered:
        return lowered.index(wanted)
    if wanted.isdigit() and int(wanted) < count:
        return int(wanted)
    if names is None:
        raise InputError(f"{source}: the names of its {count} classes are unknown; give @person=INDEX or a names file")
    known = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    raise InputError(f"{source}: no class {person_class!r} among its {count} ({known}); name one with @person=")


def names_beside(cfg: Path, count: int) -> tuple[str, ...] | None:
    """Find the names of `count` classes: NAME.names of NAME.cfg, another list beside it, COCO or VOC.

    None where nothing fits; InputError where several lists fit and disagree, or NAME.names has another length.
    """
    own = cfg.with_suffix(".names")
    if own.is_file():
        names = read_names(own)
        if len(names) != count:
            raise InputError(f"{own}: {len(names)} class names, but {cfg.name} has {count} classes")
        return names
    fitting = {names for path in sorted(cfg.parent.glob("*.names")) if len(names := read_names(path)) == count}
    if len(fitting) > 1:
        raise InputError(
            f"{cfg}: several .names files beside it list {count} classes; rename the right one to {own.name}"
        )
    return fitting.pop() if fitting else {len(COCO): COCO, len(VOC): VOC}.get(count)


def read_names(path: Path) -> tuple[str, ...]:
    """Read one class name per line; blank lines are left out."""
    lines = read_text(path, 1 << 20, errors="replace").splitlines()
    return tuple(line.strip() for line in lines if line.strip())


NAMES = ("classes", "names", "class_names", "labels")
CONFIDENCE = ("confidence", "conf", "conf_thres", "score_threshold")
LICENCE = ("licence", "license")
UNDERSTOOD = (*NAMES, *CONFIDENCE, *LICENCE, "person_class", "input", "output", "layout")
"""Keys of a description that `describe` reads."""
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
    licence: str | None = None


def read_description(path: Path) -> Description:
    """Read NAME.json beside NAME.SUFFIX, as far as it is understood (`describe`); nothing where there is none."""
    beside = path.with_suffix(".json")
    if beside == path or not beside.is_file():
        return Description()
    try:
        return describe(read_json(beside))
    except InputError as error:  # perhaps another program's, about something else
        _log.warning("%s; nothing of it is used", error)
        return Description()


def describe(record: Mapping[str, object]) -> Description:
    """Understand what a file's metadata or a JSON file says of a network.

    Understood: `classes` (or names, class_names, labels: a list, or {"0": NAME}), `person_class` (an index or a name),
    `confidence` in (0, 1), `licence`, `output.layout`, and `input` with `channels` (RGB or BGR), `range` and
    `normalisation`.
    """
    names = next((class_names for key in NAMES if (class_names := names_of(record.get(key)))), None)
    outputs, inputs = (
        part if isinstance(part, Mapping) else {} for part in (record.get("output"), record.get("input"))
    )
    layout, person = outputs.get("layout", record.get("layout")), record.get("person_class")
    if isinstance(person, str) and person in (names or ()):
        person = names.index(person)
    licences = (" ".join(word.split()) for key in LICENCE if isinstance(word := record.get(key), str))
    return Description(
        names,
        person if isinstance(person, int) and not isinstance(person, bool) and person >= 0 else None,
        layout if isinstance(layout, str) else None,
        confidence_of(record),
        _pixels(inputs),
        next(licences, None) or None,
    )


def names_of(names: object) -> tuple[str, ...] | None:
    """Read class names from a list of words, or from a word for each number; None where it is neither."""
    names = literal(names) if isinstance(names, str) else names
    if isinstance(names, Mapping):
        names = [names.get(index, names.get(str(index))) for index in range(len(names))]
    words = isinstance(names, list | tuple) and names and all(isinstance(name, str) for name in names)
    return tuple(names) if words else None


def literal(text: str) -> object:
    """Read a value that was written as Python has it (ultralytics does so); None where it is none."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return None


def confidence_of(record: Mapping[str, object]) -> float | None:
    """Find the first usual name under which a confidence in (0, 1) is said, as a number or as text."""
    for key in CONFIDENCE:
        with contextlib.suppress(KeyError, TypeError, ValueError):
            if 0 < (value := float(record[key])) < 1:
                return value
    return None


def _pixels(record: Mapping) -> PixelFormat | None:
    """Read RGB or BGR, 0..1 or 0..255; None where anything else is said."""
    channels, scale = str(record.get("channels", "")).upper(), str(record.get("range", "")).replace(" ", "")
    whites = {"[0,1]": 1.0, "0..1": 1.0, "[0,255]": 255.0, "0..255": 255.0}
    plain = str(record.get("normalisation", "none")).startswith(("none", "folded"))
    if channels not in ("RGB", "BGR") or scale not in whites or not plain:
        return None
    return PixelFormat(bgr=channels == "BGR", range=whites[scale])
