"""From a detector spec, a line of text, to a frozen detector."""

import os
import re
from pathlib import Path

import torch

from cloak_core.detectors.protocol import Detector
from cloak_core.errors import InputError

OPTIONS = re.compile(r"^(?P<rest>.*)@(?P<options>(\d+(x\d+)?|letterbox)(,(\d+(x\d+)?|letterbox))*)$")
GRAMMAR = (
    "builtin | darknet:CFG:WEIGHTS | python:FILE.py:FUNCTION, each with @SIZE or @HEIGHTxWIDTH at the end if wanted"
)


def load_detector(
    spec: str,
    *,
    input_size: int | tuple[int, int] | None = None,
    letterbox: bool = False,
    person_class: str = "person",
    device: str | torch.device = "cpu",
) -> Detector:
    """Load the detector that `spec` names, frozen, on `device`.

    Specs: `builtin`; `darknet:CFG:WEIGHTS`; `python:FILE.py:FUNCTION`. At the end of any, `@224` or `@HEIGHTxWIDTH`
    sets the network's input size and `@letterbox` (or `@416,letterbox`) keeps the aspect ratio instead of stretching;
    the arguments `input_size` (a side, or (height, width)) and `letterbox` do the same and win. `person_class` is the
    class to look for, by name or index. InputError names whatever cannot be found, read or understood.
    """
    family, rest, size, boxed = _parse(spec)
    if input_size is not None:
        size = (input_size, input_size) if isinstance(input_size, int) else (int(input_size[0]), int(input_size[1]))
    if size is not None and min(size) < 1:
        raise InputError(f"detector {spec}: an input size of {size} is not possible")
    loader = FAMILIES.get(family)
    if loader is None:
        raise InputError(f"detector {spec!r}: unknown family {family!r}; expected {GRAMMAR}")
    detector = loader(rest, spec=spec, input_size=size, letterbox=letterbox or boxed, person_class=person_class)
    return detector.to(device)


def _parse(spec: str) -> tuple[str, str, tuple[int, int] | None, bool]:
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


def _two_parts(rest: str, spec: str, form: str) -> tuple[str, str]:
    # A Windows drive letter is no separator.
    pattern = r":(?![\\/])" if os.name == "nt" else ":"
    parts = re.split(pattern, rest)
    if len(parts) != 2 or not all(parts):
        raise InputError(f"detector {spec!r}: expected {form}")
    return parts[0], parts[1]


def _load_builtin(rest: str, *, spec: str, input_size, letterbox: bool, person_class: str) -> Detector:
    from cloak_core.detectors.builtin import load_builtin

    if rest:
        raise InputError(f"detector {spec!r}: builtin takes nothing after it but @SIZE")
    return load_builtin(spec=spec, input_size=input_size, letterbox=letterbox)


def _load_darknet(rest: str, *, spec: str, input_size, letterbox: bool, person_class: str) -> Detector:
    from cloak_core.detectors.darknet.detector import load_darknet

    cfg, weights = (Path(part).expanduser() for part in _two_parts(rest, spec, "darknet:CFG:WEIGHTS"))
    return load_darknet(
        cfg,
        weights,
        name=cfg.stem,
        spec=spec,
        input_size=input_size,
        letterbox=letterbox,
        person_class=person_class,
    )


def _load_python(rest: str, *, spec: str, input_size, letterbox: bool, person_class: str) -> Detector:
    from cloak_core.detectors.python_module import load_python

    file, function = _two_parts(rest, spec, "python:FILE.py:FUNCTION")
    return load_python(Path(file).expanduser(), function, spec=spec, input_size=input_size, letterbox=letterbox)


FAMILIES = {"builtin": _load_builtin, "darknet": _load_darknet, "python": _load_python}
