"""Detectors that a program has as objects: any module, a torchvision model, a function on pictures."""

from __future__ import annotations

import contextlib
import copy
import hashlib
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.surroundings import plain_torch
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.maite import MaiteModel
from cloak_core.detectors.python_module import PythonDetector
from cloak_core.detectors.reachable import content_of
from cloak_core.files.errors import InputError, first_line

Given = Detector | nn.Module | Callable | str
"""What may be given for a detector; `as_detector` says how."""
PERSON = 1
"""Of torchvision's models: in COCO's numbering, and the first class of one trained on persons alone."""


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
        return _copied(given) if _is_foreign(given) else given
    if isinstance(given, str):
        return load_detector(given, device=device)
    metadata = getattr(given, "metadata", None)
    if callable(given) and isinstance(metadata, Mapping) and "id" in metadata:  # as MAITE's models are called
        made = _module(MaiteModel(given), given, device)
        made.name = made.spec = str(metadata["id"])
    elif isinstance(given, nn.Module):
        module = _copied(given)
        made = _torchvision(module) or _module(module, type(given), device)
        given = module
    elif callable(given) and not isinstance(given, type):
        made = _module(OnPictures(given), given, device)
    else:
        raise InputError(
            f"detectors: {type(given).__name__} {str(given)[:40]!r} is no detector: give a module, a function, a spec"
        )
    made.look_again = lambda: {"content": content_of(given)}
    return made.to(device)


def as_detectors(given: object, device: str | torch.device = "cpu") -> list[Detector]:
    """Make a list of detectors of one or several; objects of one class get different names."""
    several = given if isinstance(given, (list, tuple)) else [given]
    made = [as_detector(one, device) for one in several]
    for number, detector in enumerate(made):
        same = sum(other.spec == detector.spec for other in made[:number])
        if same and not isinstance(several[number], (Detector, str)):
            detector.spec = detector.name = f"{detector.spec}-{same + 1}"
    return made


class OnPictures(nn.Module):
    """A function on one picture [H, W, 3] uint8, as a module on images; no gradients."""

    differentiable = False

    def __init__(self, function: Callable) -> None:
        super().__init__()
        self.function = function

    @torch.no_grad()
    def forward(self, images: Float[Tensor, "B 3 H W"]) -> tuple[Tensor, Tensor]:
        pictures = (255 * images).round().to(torch.uint8).permute(0, 2, 3, 1).cpu().numpy()
        rows = [self._rows(picture) for picture in pictures]
        padded = np.zeros((len(rows), max(map(len, rows), default=0), 5), np.float32)
        for place, found in zip(padded, rows, strict=True):
            place[: len(found)] = found
        answer = torch.from_numpy(padded).to(images.device)
        return answer[..., :4], answer[..., 4]

    def _rows(self, picture: np.ndarray) -> np.ndarray:
        """Ask about one picture: rows of x1, y1, x2, y2, score."""
        answer = self.function(picture)
        if isinstance(answer, tuple) and len(answer) == 2:
            boxes, scores = (np.asarray(part, np.float32) for part in answer)
            answer = np.concatenate([boxes.reshape(-1, 4), scores.reshape(-1, 1)], axis=1)
        return np.asarray(answer, np.float32).reshape(-1, 5)


def _module(module: nn.Module, named: object, device: str | torch.device) -> PythonDetector:
    """Wrap a module under the name of its class, or of a function, with a hash of that one's source."""
    name = getattr(named, "__name__", type(named).__name__)
    kind = named if isinstance(named, type) or inspect.isroutine(named) else type(named)
    file, source = None, f"{kind.__module__}.{kind.__qualname__}"
    with contextlib.suppress(OSError, TypeError):  # made where there is no file, as in a notebook
        file = inspect.getsourcefile(kind)
        source = inspect.getsource(kind)
    detector = PythonDetector(module, name, name, file=Path(file) if file else None)
    # Without weights the source is all that tells two apart.
    detector.source = {"object": name, "code": hashlib.sha256(source.encode()).hexdigest()}
    return detector.to(device).freeze()


def _is_foreign(module: nn.Module) -> bool:
    """Tell whether images in float32 and their gradients do not go through a module: it was made in inference mode, or
    where float64 is the default."""
    of_numbers = any(parameter.dtype == torch.float64 for parameter in module.parameters())
    return of_numbers or any(t.is_inference() for t in (*module.parameters(), *module.buffers()))


def _torchvision(model: nn.Module) -> Detector | None:
    """Make a detector of one of torchvision's detection models; None for any other module."""
    from torchvision.models import detection

    from cloak_core.detectors.torchvision_family import wrapped

    kinds = detection.generalized_rcnn.GeneralizedRCNN, detection.RetinaNet, detection.FCOS, detection.ssd.SSD
    name = type(model).__name__
    return wrapped(model, PERSON, name, name, None, channels_last=False) if isinstance(model, kinds) else None


def _copied(module: nn.Module) -> nn.Module:
    """Copy a module; what was made where float64 is the default is float32 then. InputError: it cannot be copied."""
    try:
        made = copy.deepcopy(module)
    except Exception as error:  # modules fail to be copied in their own ways
        name = type(module).__name__
        raise InputError(
            f"detectors: {name} cannot be copied ({first_line(error)}): wrap it in one that can"
        ) from error
    for tensor in (*made.parameters(), *made.buffers()) if _is_foreign(made) else ():
        if tensor.dtype == torch.float64:
            tensor.data = tensor.data.float()
    return made
