"""From a detector spec, a line of text, to a frozen detector."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from cloak_core.detectors.compiling import compile_detector
from cloak_core.detectors.protocol import Detector
from cloak_core.detectors.specs import PERSON, parse_spec, with_person_class
from cloak_core.files.errors import InputError

PRECISIONS = ("float32", "bfloat16", "auto")


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
    layout: str | None
    """Of an ONNX model's outputs."""
    download: bool
    """Whether missing official weights may be fetched."""

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
    person_class: str | None = None,
    device: str | torch.device = "cpu",
    precision: str = "float32",
    compiled: bool = False,
    layout: str | None = None,
    download: bool = False,
    fold: bool = True,
) -> Detector:
    """Load the detector that `spec` names, frozen, on `device`.

    Specs: `builtin`; `darknet:CFG:WEIGHTS`; `torchvision:NAME[:CHECKPOINT]`;
    `transformers:DIRECTORY_OR_CACHED_NAME`; `onnx:FILE[:LAYOUT]`; `python:FILE.py:FUNCTION`. At the end of any, options
    after an @ and joined by commas: `224` or `HEIGHTxWIDTH` sets the network's input size, `letterbox` keeps the aspect
    ratio instead of stretching, `person=CLASS` says which class to look for, by name or index ("person" unless told).
    The arguments `input_size` (a side, or (height, width)), `letterbox` and `person_class` do the same and win, and
    `layout` is that of an ONNX model's outputs. The detector's own `spec` always says which class it looks for.

    `precision`: "float32"; "bfloat16" (see `Detector`); "auto", bfloat16 where the device gains. `compiled` runs it
    through torch.compile. `download` allows official weights to be fetched where they are missing; without it nothing
    is. `fold=False` leaves batch norm and memory layout as they were trained, to measure against.
    InputError names whatever cannot be found, read or understood.
    """
    parsed = parse_spec(spec)
    size = parsed.size
    if input_size is not None:
        size = (input_size, input_size) if isinstance(input_size, int) else (int(input_size[0]), int(input_size[1]))
    if size is not None and min(size) < 1:
        raise InputError(f"detector {spec}: an input size of {size} is not possible")
    if parsed.family not in FAMILIES:
        forms = " | ".join(known.form for known in FAMILIES.values())
        raise InputError(
            f"detector {spec!r}: unknown family {parsed.family!r}; expected {forms}, @SIZE at the end if wanted"
        )
    if layout is not None and parsed.family != "onnx":
        raise InputError(f"detector {spec!r}: --layout is for onnx:FILE")
    try:
        device = torch.device(device)
    except RuntimeError as error:
        raise InputError(f"--device {device}: {str(error).splitlines()[0]}") from None
    precision = _precision(precision, device)
    if person_class is not None:
        spec = with_person_class(spec, person_class)
    person = person_class or parsed.person_class or PERSON
    letterbox = letterbox or parsed.letterbox
    request = Request(spec, parsed.family, parsed.rest, size, letterbox, person, fold, layout, download)
    detector = FAMILIES[parsed.family].load(request).to(device)
    detector.precision = precision
    return compile_detector(detector) if compiled else detector


def _precision(wanted: str, device: torch.device) -> Literal["float32", "bfloat16"]:
    if wanted not in PRECISIONS:
        raise InputError(f"--precision: {wanted!r} is not one of {', '.join(PRECISIONS)}")
    if wanted != "auto":
        return wanted
    # Tensor cores for bfloat16 came with compute capability 8; CPUs gained nothing where it was measured.
    fast = device.type == "cuda" and torch.cuda.get_device_capability(device)[0] >= 8
    return "bfloat16" if fast else "float32"


def _load_builtin(request: Request) -> Detector:
    from cloak_core.detectors.builtin import load_builtin

    if request.rest:
        raise InputError(f"detector {request.spec!r}: builtin takes nothing after it but @SIZE")
    return load_builtin(
        spec=request.spec,
        input_size=request.input_size,
        letterbox=request.letterbox,
        person_class=request.person_class,
        fold=request.fold,
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
        download=request.download,
    )


def _load_transformers(request: Request) -> Detector:
    from cloak_core.detectors.transformers_family import load_transformers

    if request.letterbox or not request.rest:
        raise InputError(f"detector {request.spec!r}: expected {FAMILIES[request.family].form}, without letterbox")
    return load_transformers(
        request.rest,
        spec=request.spec,
        input_size=request.input_size,
        person_class=request.person_class,
        download=request.download,
        fold=request.fold,
    )


def _load_onnx(request: Request) -> Detector:
    from cloak_core.detectors.onnx_model import load_onnx

    file, *layout = request.parts(1, 2)
    if layout and request.layout:
        raise InputError(f"detector {request.spec!r}: names its layout already; drop --layout")
    return load_onnx(
        Path(file).expanduser(),
        request.layout or (layout[0] if layout else None),
        spec=request.spec,
        input_size=request.input_size,
        person_class=request.person_class,
    )


def _load_python(request: Request) -> Detector:
    from cloak_core.detectors.python_module import load_python

    file, function = request.parts(2)
    if request.person_class != PERSON:
        raise InputError(
            f"detector {request.spec!r}: a python module returns the person's scores itself, it has no class to choose "
            "(for one of several detectors write the class into its spec: SPEC@person=CLASS)"
        )
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
