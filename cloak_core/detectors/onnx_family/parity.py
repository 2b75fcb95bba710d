"""Whether a converted network answers as onnxruntime does, for one image and for several, and whether its gradient is
one: asked once for each file and each version of what converts it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.decoding import Decoded
from cloak_core.detectors.verification.comparing import (
    AGREES,
    BOXES_PX,
    SCORES,
    Apart,
    gradient_error,
    in_any_order,
)
from cloak_core.files.caching import DiskCache, cache_folder
from cloak_core.files.errors import InputError
from cloak_core.files.identity import code_hash, sha256_arrays
from cloak_core.files.reading import parse_json

LIMIT_BYTES = 1 << 20
FEW = 1000
"""Rows that a network answers with, where it may have chosen them."""
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
    def same(self) -> bool:
        """One image is answered alike."""
        return self.scores is not None and self.scores <= SCORES and self.boxes_px <= BOXES_PX

    @property
    def agrees(self) -> bool:
        """One image is answered alike, and its gradient is right: the network can be trained against."""
        return self.same and self.gradient is not None and self.gradient <= AGREES

    @property
    def takes_batches(self) -> bool:
        """Several images at once are answered as they are one by one."""
        return self.batch_scores is not None and self.batch_scores <= SCORES


def compare(converted: Answer, original: Answer, images: Float[Tensor, "B 3 H W"]) -> Parity:
    """Ask both about images as the network takes them (`original` image by image: it may not take several)."""
    with torch.no_grad():
        expected = [original(image) for image in images.split(1)]
        try:
            alone = [converted(image) for image in images.split(1)]
        except Exception as error:
            return Parity(None, None, None, None, f"it fails in torch ({type(error).__name__}: {error})")
        scores, boxes = apart(alone, expected)
        try:
            together = converted(images)
            batch = max(apart([_row(together, i)], [expected[i]])[0] for i in range(len(images)))
        except Exception:  # a graph of a fixed batch fails in many ways
            batch = None
    gradient = gradient_error(lambda pixels: converted(pixels).scores, images[:1])
    return Parity(scores, boxes, batch, gradient)


def takes_batches(network: Callable[[Tensor], list[Tensor]], images: Float[Tensor, "B 3 H W"]) -> bool:
    """Tell whether a black box answers two images at once as it does one by one."""
    try:
        together = network(images[:2])
    except Exception:  # onnxruntime's own
        return False
    alone = [torch.cat(parts) for parts in zip(*(network(image) for image in images[:2].split(1)), strict=True)]
    same = (
        a.shape == b.shape and torch.allclose(a, b, atol=1e-3, rtol=1e-3) for a, b in zip(together, alone, strict=True)
    )
    return all(same)


def remembered(key: str, find: Callable[[], Parity]) -> Parity:
    """Look up what was found for this content and these versions before, else find it now and remember it."""
    versions = [f"{name} {version(name)}" for name in ("torch", "onnx", "onnx2torch", "onnxruntime")]
    versions.append(code_hash("detectors/onnx_family"))
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


def apart(some: list[Decoded], others: list[Decoded]) -> tuple[float, float]:
    """Find the largest difference of scores and of boxes; infinite where shapes differ or a number is not finite.

    Where a graph chooses its rows, rounding may exchange two of them: few rows are compared in any order, too.
    """
    worst = Apart(0.0, 0.0)
    for a, b in zip(some, others, strict=True):
        if a.boxes.shape != b.boxes.shape or a.classes.shape != b.classes.shape:
            return float("inf"), float("inf")
        found = Apart(_largest(a.scores - b.scores), _largest(a.boxes - b.boxes))
        if not found.same and a.boxes.shape[1] <= FEW:
            found = in_any_order(*(torch.cat([one.boxes[0], one.scores[0]], dim=1) for one in (a, b)))
        worst = Apart(*map(max, worst, found))
    return worst


def _largest(difference: Tensor) -> float:
    worst = float(difference.abs().max()) if difference.numel() else 0.0
    return worst if np.isfinite(worst) else float("inf")
