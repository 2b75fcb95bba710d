"""Whether a converted network answers as onnxruntime does, for one image and for several, and whether its gradient is
one: asked once for each file and each version of what converts it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib.metadata import version

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.onnx_family.layouts import Decoded
from cloak_core.files.caching import DiskCache, cache_folder
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.files.reading import parse_json
from cloak_core.scene.backdrops.procedural import draw_scene

SCORES, BOXES_PX, GRADIENT = 1e-4, 0.05, 0.1
"""The largest differences that count as equal; the gradient's is relative to a finite difference."""
IMAGES = 4
SURE = 20
"""The gradient is judged on the sum of so many of the best scores' logarithms."""
LIMIT_BYTES = 1 << 20
Answer = Callable[[Float[Tensor, "B 3 H W"]], Decoded]


@dataclass(frozen=True)
class Parity:
    """What the comparison found; figures are None where they were not reached."""

    scores: float | None
    """Largest difference of any class's score, of images one by one."""
    boxes_px: float | None
    """Largest difference of any coordinate, pixels of the input."""
    batch_scores: float | None
    """As `scores`, of all images at once."""
    gradient: float | None
    """Relative difference of the slope along the gradient and a finite difference."""
    why: str = ""
    """What went wrong, in words; "" for nothing."""

    @property
    def agrees(self) -> bool:
        """One image is answered alike, and its gradient is right: the network can be trained against."""
        near = self.scores is not None and self.scores <= SCORES and self.boxes_px <= BOXES_PX
        return near and self.gradient is not None and self.gradient <= GRADIENT

    @property
    def takes_batches(self) -> bool:
        """Several images at once are answered as they are one by one."""
        return self.batch_scores is not None and self.batch_scores <= SCORES


@lru_cache(4)
def sample_images(size: tuple[int, int]) -> Float[Tensor, "B 3 H W"]:
    """Procedural scenes, always the same ones."""
    scenes = [draw_scene(np.random.default_rng([7, i]), *size) for i in range(IMAGES)]
    return torch.from_numpy(np.stack(scenes)).permute(0, 3, 1, 2).float() / 255


def compare(converted: Answer, original: Answer, images: Float[Tensor, "B 3 H W"]) -> Parity:
    """Ask both about images as the network takes them (`original` image by image: it may not take several)."""
    with torch.no_grad():
        expected = [original(image) for image in images.split(1)]
        try:
            alone = [converted(image) for image in images.split(1)]
        except Exception as error:
            return Parity(None, None, None, None, f"it fails in torch ({type(error).__name__}: {error})")
        scores, boxes = _apart(alone, expected)
        try:
            together = converted(images)
            batch = max(_apart([_row(together, i)], [expected[i]])[0] for i in range(len(images)))
        except Exception:  # a graph of a fixed batch fails in many ways
            batch = None
    gradient = _gradient_error(converted, images[:1])
    return Parity(scores, boxes, batch, gradient)


def remembered(key: str, find: Callable[[], Parity]) -> Parity:
    """What was found for this content before, by this version of the packages; else found now, and remembered."""
    versions = [f"{name} {version(name)}" for name in ("torch", "onnx", "onnx2torch", "onnxruntime")]
    name = sha256_arrays(np.frombuffer("\n".join([key, *versions]).encode(), np.uint8))
    files = DiskCache(cache_folder("onnx"), ".parity", LIMIT_BYTES, "checks of converted networks")
    known = files.get(name)
    if known is not None:
        with contextlib.suppress(InputError, TypeError):  # of another version
            return Parity(**parse_json(known.tobytes(), name))
    found = find()
    files.put(name, json.dumps(asdict(found)).encode())
    return found


def _row(decoded: Decoded, index: int) -> Decoded:
    return Decoded(*(part if part is None else part[index : index + 1] for part in decoded))


def _apart(some: list[Decoded], others: list[Decoded]) -> tuple[float, float]:
    """Largest difference of scores and of boxes; infinite where shapes differ or something is not finite."""
    scores = boxes = 0.0
    for a, b in zip(some, others, strict=True):
        if a.boxes.shape != b.boxes.shape or a.classes.shape != b.classes.shape:
            return float("inf"), float("inf")
        scores = max(scores, _largest(_scores(a) - _scores(b)))
        boxes = max(boxes, _largest(a.boxes - b.boxes))
    return scores, boxes


def _scores(decoded: Decoded) -> Tensor:
    return decoded.classes if decoded.objectness is None else decoded.classes * decoded.objectness[..., None]


def _largest(difference: Tensor) -> float:
    worst = float(difference.abs().max()) if difference.numel() else 0.0
    return worst if np.isfinite(worst) else float("inf")


def _gradient_error(answer: Answer, image: Float[Tensor, "1 3 H W"]) -> float | None:
    """How far the slope along the gradient is from a finite difference, relative; the best of several step widths,
    because networks are rough and float32 is coarse. None where there is no finite gradient."""

    def sureness(pixels: Tensor) -> Tensor:
        return _scores(answer(pixels)).flatten().clamp(min=1e-30).log().topk(SURE).values.sum()

    pixels = image.clone().requires_grad_()
    try:
        (gradient,) = torch.autograd.grad(sureness(pixels), pixels)
    except RuntimeError:  # nothing leads from the scores to the pixels
        return None
    length = float(gradient.norm())
    if not np.isfinite(length) or length == 0:
        return None
    errors = []
    with torch.no_grad():
        for step in (0.3, 0.1, 0.03, 0.01):
            way = step * gradient / length
            slope = float(sureness(image + way) - sureness(image - way)) / (2 * step)
            errors.append(abs(slope - length) / length)
    return min(errors)
