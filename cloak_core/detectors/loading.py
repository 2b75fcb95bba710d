"""From a detector spec, a line of text, to a frozen detector."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch

from cloak_core.detectors.protocol import Detector
from cloak_core.errors import InputError

OPTIONS = re.compile(r"^(?P<rest>.*)@(?P<options>(\d+(x\d+)?|letterbox)(,(\d+(x\d+)?|letterbox))*)$")
PRECISIONS = ("float32", "bfloat16")


@dataclass(frozen=True)
class Request:
    """A spec taken apart, with what `load_detector` was told beside it."""

    spec: str
    family: str
    rest: str
    input_size: tuple[int, int] | None
    """(height, width), None for the detector's own."""
    letterbox: bool
    person_class: str
    fold: bool

    def parts(self, least: int, most: int | None = None) -> list[str]:
        """The colon-separated parts after the family; InputError when there are too few, too many or empty ones."""
        # A Windows drive letter is no separator.
        parts = re.split(r":(?![\\/])" if os.name == "nt" else ":", self.rest)
        if not least <= len(parts) <= (most or least) or not all(parts):
            raise InputError(f"detector {self.spec!r}: expected {FAMILIES[self.family].form}")
        return parts


@dataclass(frozen=True)
class Family:
    """How one kind of detector is written and loaded."""

    form: str
    load: Callable[[Request], Detector]


def load_detector(
    spec: str,
    *,
    input_size: int | tuple[int, int] | None = None,
    letterbox: bool = False,
    person_class: str = "person",
    device: str | torch.device = "cpu",
    precision: str = "float32",
    fold: bool = True,
) -> Detector:
    """Load the detector that `spec` names, frozen, on `device`.

    Specs: `builtin`; `darknet:CFG:WEIGHTS`; `torchvision:NAME[:CHECKPOINT]`;
    `transformers:DIRECTORY_OR_CACHED_NAME`; `onnx:FILE[:LAYOUT]`; `python:FILE.py:FUNCTION`. At the end of any,
    `@224` or `@HEIGHTxWIDTH` sets the network's input size and `@letterbox` (or `@416,letterbox`) keeps the aspect
    ratio instead of stretching; the arguments `input_size` (a side, or (height, width)) and `letterbox` do the same and
    win. `person_class` is the class to look for, by name or index. `precision` "bfloat16" is for training only (see
    `Detector`); `fold=False` leaves batch norm and memory layout as they were trained, to measure against.
    InputError names whatever cannot be found, read or understood.
    """
    family, rest, size, boxed = _take_apart(spec)
    if input_size is not None:
        size = (input_size, input_size) if isinstance(input_size, int) else (int(input_size[0]), int(input_size[1]))
    if size is not None and min(size) < 1:
        raise InputError(f"detector {spec}: an input size of {size} is not possible")
    if family not in FAMILIES:
        forms = " | ".join(known.form for known in FAMILIES.values())
        raise InputError(f"detector {spec!r}: unknown family {family!r}; expected {forms}, @SIZE at the end if wanted")
    if precision not in PRECISIONS:
        raise InputError(f"precision {precision!r}: expected {' or '.join(PRECISIONS)}")
    request = Request(spec, family, rest, size, letterbox or boxed, person_class, fold)
    detector = FAMILIES[family].load(request).to(device)
    detector.precision = precision
    return detector


def _take_apart(spec: str) -> tuple[str, str, tuple[int, int] | None, bool]:
    """Family, the rest, input size, letterbox."""
    match = OPTIONS.match(spec)
    rest, options = (match["rest"], match["options"].split(",")) if match else (spec, [])
    size = None
    for option in options:
        if option != "letterbox":
            sides = [int(side) for side in option.split("x")]
            size = (sides[0], sides[-1])
    family, _, rest = rest.partition(":")
    return family, rest, size, "letterbox" in options


def _load_builtin(request: Request) -> Detector:
    from cloak_core.detectors.builtin import load_builtin

    if request.rest:
        raise InputError(f"detector {request.spec!r}: builtin takes nothing after it but @SIZE")
    return load_builtin(
        spec=request.spec, input_size=request.input_size, letterbox=request.letterbox, fold=request.fold
    )


def _load_darknet(request: Request) -> Detector:
    from cloak_core.detectors.darknet.detector import load_darknet

    cfg, weights = (Path(part).expanduser() for part in request.parts(2))
    return load_darknet(
        cfg,
        weights,
        name=cfg.stem,
        spec=request.spec,
        input_size=request.input_size,
        letterbox=request.letterbox,
        person_class=request.person_class,
        fold=request.fold,
    )


def _load_torchvision(request: Request) -> Detector:
    from cloak_core.detectors.torchvision_family.loading import load_torchvision

    if request.letterbox:
        raise InputError(f"detector {request.spec!r}: torchvision models resize by themselves; drop letterbox")
    name, *checkpoint = request.parts(1, 2)
    return load_torchvision(
        name,
        checkpoint[0] if checkpoint else None,
        spec=request.spec,
        input_size=request.input_size,
        person_class=request.person_class,
        fold=request.fold,
    )


def _load_transformers(request: Request) -> Detector:
    from cloak_core.detectors.transformers_family import load_transformers

    if request.letterbox or not request.rest:
        raise InputError(f"detector {request.spec!r}: expected {FAMILIES[request.family].form}, without letterbox")
    return load_transformers(
        request.rest, spec=request.spec, input_size=request.input_size, person_class=request.person_class
    )


def _load_onnx(request: Request) -> Detector:
    from cloak_core.detectors.onnx_model import load_onnx

    file, *layout = request.parts(1, 2)
    return load_onnx(
        Path(file).expanduser(),
        layout[0] if layout else None,
        spec=request.spec,
        input_size=request.input_size,
        person_class=request.person_class,
    )


def _load_python(request: Request) -> Detector:
    from cloak_core.detectors.python_module import load_python

    file, function = request.parts(2)
    return load_python(
        Path(file).expanduser(),
        function,
        spec=request.spec,
        input_size=request.input_size,
        letterbox=request.letterbox,
        fold=request.fold,
    )


FAMILIES = {
    "builtin": Family("builtin", _load_builtin),
    "darknet": Family("darknet:CFG:WEIGHTS", _load_darknet),
    "torchvision": Family("torchvision:NAME[:CHECKPOINT]", _load_torchvision),
    "transformers": Family("transformers:DIRECTORY_OR_CACHED_NAME", _load_transformers),
    "onnx": Family("onnx:FILE[:LAYOUT]", _load_onnx),
    "python": Family("python:FILE.py:FUNCTION", _load_python),
}
