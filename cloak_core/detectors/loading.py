"""From a detector spec, a line of text, or from what a program has, to a frozen detector."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import torch
from torch import nn

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.surroundings import copied, is_foreign, plain_torch, usable_device
from cloak_core.detectors.defended.table import read_head, split_defence
from cloak_core.detectors.families import FAMILIES
from cloak_core.detectors.naming import full_spec, refuse_typing_errors
from cloak_core.detectors.specs import parse_spec
from cloak_core.files.errors import InputError, first_line

PRECISIONS = ("float32", "bfloat16", "auto")
Given = Detector | nn.Module | Callable | str
"""What may be given for a detector; `as_detector` says how."""


@plain_torch()
def load_detector(
    spec: str,
    *,
    device: str | torch.device = "cpu",
    precision: str = "float32",
    compiled: bool = False,
    download: bool = False,
    fold: bool = True,
) -> Detector:
    """Load the detector that `spec` names, frozen, on `device`.

    `families.FAMILIES` has the forms of specs; a file alone is taken by its suffix (`naming.full_spec`). At the end of
    any, options after an @ and joined by commas: `224` or `HEIGHTxWIDTH` sets the network's input size, `letterbox`
    keeps the aspect ratio instead of stretching, `person=CLASS` says which class to look for, by name or index
    ("person" unless told).

    `precision`: "float32"; "bfloat16" (see `Detector`); "auto", bfloat16 where the device gains. `compiled` runs it
    through torch.compile. `download` allows official weights to be fetched where they are missing; without it nothing
    is. `fold=False` leaves batch norm and memory layout as they were trained, to measure against.
    Before any spec may stand defences, `jpeg=75:SPEC` (`defended.table.DEFENCES`); all else is said of the detector
    behind them. InputError names whatever cannot be found, read or understood.
    """
    spec, place = full_spec(spec), usable_device(device)
    chosen = _precision(precision, place)
    if (defended := split_defence(spec)) is not None:
        from cloak_core.detectors.defended.detector import defend

        head, rest = defended
        read_head(head, spec)  # before anything is loaded
        detector = defend(load_detector(rest, device=device, compiled=compiled, download=download, fold=fold), head)
        detector.precision = chosen
        return detector
    request = replace(parse_spec(spec), download=download, fold=fold)
    family = FAMILIES[request.family]
    family.check(request)
    refuse_typing_errors(request.spec)
    detector = family.load(request).to(place)
    detector.precision = chosen
    if request.confidence is not None:
        detector.operating_point, detector.operating_point_assumed = request.confidence, False
    return compile_detector(detector) if compiled else detector


def _precision(wanted: str, device: torch.device) -> Literal["float32", "bfloat16"]:
    if wanted not in PRECISIONS:
        raise InputError(f"--precision: {wanted!r} is not one of {', '.join(PRECISIONS)}")
    if wanted != "auto":
        return wanted
    # Tensor cores for bfloat16 came with compute capability 8; CPUs gained nothing where it was measured.
    fast = device.type == "cuda" and torch.cuda.get_device_capability(device)[0] >= 8
    return "bfloat16" if fast else "float32"


def compile_detector(detector: Detector) -> Detector:
    """Compile the detector's `detect`. InputError: a black box, or no compiler is found.

    Results equal the uncompiled ones up to rounding; what torch cannot compile runs as before.
    """
    if not detector.differentiable:
        raise InputError(f"--compile: {detector.spec} does not run in torch")
    run = torch.compile(detector.detect)

    def detect(images: torch.Tensor) -> Detections:
        try:
            return run(images)
        except (torch._inductor.exc.InvalidCxxCompiler, torch._dynamo.exc.BackendCompilerFailed) as error:
            reason = first_line(error)[:160]
            raise InputError(
                f"--compile: torch cannot compile here ({reason}); install a C++ compiler, or drop it"
            ) from error

    detector.detect, detector.compiled = detect, True
    return detector


@plain_torch()
def as_detector(given: object, device: str | torch.device = "cpu") -> Detector:
    """Make a detector of what a program has, on `device`.

    A `Detector` stays as it is; a spec or a detector's file is loaded. A torchvision detection model finds class 1, the
    person in COCO and wherever persons are the only class. Any other `nn.Module` takes images [B, 3, H, W], RGB in
    [0, 1], and returns (boxes [B, N, 4] as xyxy in pixels, person scores [B, N] in [0, 1]), or `Detections`. Any other
    callable is a black box: it takes one picture [H, W, 3] uint8 and returns boxes [n, 4] and scores [n], or rows
    [n, 5]. A model of MAITE's object-detection protocol is one, too (`maite.MaiteModel`). Modules are copied: the
    caller's keep their mode and their gradients. InputError: none of these.
    """
    if isinstance(given, Detector):
        return copied(given) if is_foreign(given) else given
    if isinstance(given, str):
        return load_detector(given, device=device)
    from cloak_core.detectors.objects import detector_of

    return detector_of(given, device)


def as_detectors(given: object, device: str | torch.device = "cpu") -> list[Detector]:
    """Make a list of detectors of one or several; objects of one class get different names."""
    several = given if isinstance(given, (list, tuple)) else [given]
    made = [as_detector(one, device) for one in several]
    for number, detector in enumerate(made):
        same = sum(other.spec == detector.spec for other in made[:number])
        if same and not isinstance(several[number], (Detector, str)):
            detector.spec = detector.name = f"{detector.spec}-{same + 1}"
    return made
