"""Whether a converted network answers as onnxruntime does, for one image and for several, and whether its gradient is
one: asked once for each file and each version of what converts it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from importlib.metadata import version
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.decoding import Decoded
from cloak_core.detectors.verification.comparing import (
    AGREES,
    Apart,
    gradient_error,
    in_any_order,
    largest_difference,
    sureness,
)
from cloak_core.files.caching import DiskCache, cache_folder
from cloak_core.files.errors import InputError
from cloak_core.files.identity import code_hash, sha256_arrays
from cloak_core.files.reading import parse_json

LIMIT_BYTES = 1 << 20
FEW = 1000
"""Rows that a network answers with, where it may have chosen them."""
Answer = Callable[[Float[Tensor, "B 3 H W"]], Decoded]


class Verdict(NamedTuple):
    """Whether a converted network can be trained against."""

    why_not: str
    """"" where it can."""
    takes_batches: bool
    """Several images at once are answered as they are one by one."""


def compare(converted: Answer, original: Answer, images: Float[Tensor, "B 3 H W"]) -> Verdict:
    """Ask both about images as the network takes them (`original` image by image: it may not take several)."""
    with torch.no_grad():
        expected = [original(image) for image in images.split(1)]
        try:
            alone = [converted(image) for image in images.split(1)]
        except Exception as error:
            return Verdict(f"it fails in torch ({type(error).__name__}: {error})", False)
        difference = apart(alone, expected)
        try:
            together = converted(images)
            parts = [Decoded(*(p if p is None else p[i : i + 1] for p in together)) for i in range(len(images))]
            takes_batches = Apart(apart(parts, expected).scores, 0.0).same
        except Exception:  # a graph of a fixed batch fails in many ways
            takes_batches = False
    if not difference.same:
        figures = f"scores by {difference.scores:.1e}, boxes by {difference.boxes_px:.2f} px"
        return Verdict(f"converted to torch it answers otherwise than in onnxruntime ({figures})", takes_batches)
    gradient = gradient_error(lambda pixels: sureness(converted(pixels).scores), images[:1])
    if gradient is None:
        return Verdict("its scores have no finite gradient in the image", takes_batches)
    why_not = "" if gradient <= AGREES else f"its gradient is {gradient:.0%} off a finite difference"
    return Verdict(why_not, takes_batches)


def takes_batches(network: Callable[[Tensor], list[Tensor]], images: Float[Tensor, "B 3 H W"]) -> bool:
    """Tell whether a black box answers two images at once as it does one by one."""
    try:
        together = network(images[:2])
    except Exception:  # onnxruntime's own
        return False
    alone = [torch.cat(parts) for parts in zip(*(network(image) for image in images[:2].split(1)), strict=True)]
    pairs = zip(together, alone, strict=True)
    return all(a.shape == b.shape and torch.allclose(a, b, atol=1e-3, rtol=1e-3) for a, b in pairs)


def remembered(key: str, find: Callable[[], Verdict]) -> Verdict:
    """Look up what was found for this content and these versions before, else find it now and remember it."""
    versions = [f"{name} {version(name)}" for name in ("torch", "onnx", "onnx2torch", "onnxruntime")]
    versions.append(code_hash("detectors/onnx_family"))
    name = sha256_arrays(np.frombuffer("\n".join([key, *versions]).encode(), np.uint8))
    files = DiskCache(cache_folder("onnx"), ".parity", LIMIT_BYTES, "checks of converted networks")
    known = files.get(name)
    if known is not None:
        with contextlib.suppress(InputError, TypeError):  # of another version
            return Verdict(**parse_json(known.tobytes(), name))
    found = find()
    files.put(name, json.dumps(found._asdict()).encode())
    return found


def apart(some: list[Decoded], others: list[Decoded]) -> Apart:
    """Find the largest difference of scores and of boxes; infinite where shapes differ or a number is not finite.

    Where a graph chooses its rows, rounding may exchange two of them: few rows are compared in any order, too.
    """
    worst = Apart(0.0, 0.0)
    for a, b in zip(some, others, strict=True):
        if a.boxes.shape != b.boxes.shape or a.classes.shape != b.classes.shape:
            return Apart(float("inf"), float("inf"))
        rows = [torch.cat([one.boxes[0], one.scores[0]], dim=1) for one in (a, b)]
        found = largest_difference(rows[0], rows[1])
        if not found.same and len(rows[0]) <= FEW:
            found = in_any_order(*rows)
        worst = worst.joined(found)
    return worst
