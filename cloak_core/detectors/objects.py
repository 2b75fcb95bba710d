"""Detectors that a program has as objects: any module, a torchvision model, a function on pictures."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.surroundings import copied
from cloak_core.detectors.maite import MaiteModel
from cloak_core.detectors.python_module import PythonDetector
from cloak_core.detectors.reachable import content_of
from cloak_core.files.errors import InputError

PERSON = 1
"""Of torchvision's models: in COCO's numbering, and the first class of one trained on persons alone."""


def detector_of(given: object, device: str | torch.device) -> Detector:
    """Make a detector of a module, a function or a model; see `loading.as_detector`. InputError: none of these."""
    metadata = getattr(given, "metadata", None)
    if callable(given) and isinstance(metadata, Mapping) and "id" in metadata:  # as MAITE's models are called
        made = _module(MaiteModel(given), given, device)
        made.name = made.spec = str(metadata["id"])
    elif isinstance(given, nn.Module):
        module = copied(given)
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


def _torchvision(model: nn.Module) -> Detector | None:
    """Make a detector of one of torchvision's detection models; None for any other module."""
    from torchvision.models import detection

    from cloak_core.detectors.torchvision_family import wrapped

    kinds = detection.generalized_rcnn.GeneralizedRCNN, detection.RetinaNet, detection.FCOS, detection.ssd.SSD
    name = type(model).__name__
    return wrapped(model, PERSON, name, name, None, channels_last=False) if isinstance(model, kinds) else None
