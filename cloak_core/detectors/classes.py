"""Class lists: which index of a detector's output is the person."""

from collections.abc import Sequence
from pathlib import Path

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_text

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
        raise InputError(
            f"{source}: the names of its {count} classes are unknown; give --person-class INDEX or a names file"
        )
    known = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    raise InputError(f"{source}: no class {person_class!r} among its {count} ({known}); name one with --person-class")


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
