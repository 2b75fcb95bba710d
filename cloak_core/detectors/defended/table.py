"""The defences: how each is written, what number it takes, what it is after.

A new one is a row of `DEFENCES` and a `detector.Defence`.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    from cloak_core.detectors.defended.detector import Defence


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of defence."""

    value: str
    """What its number means."""
    least: float
    most: float
    step: int | None = None
    """The number is `least` plus a multiple of this; None: any number."""
    usual: float | None = None
    """The number where none is given; None: one must be."""
    made_by: str
    """MODULE:CLASS below cloak_core.detectors.defended, made from the number."""
    what: str

    @property
    def bounds(self) -> str:
        kind = {None: "a number", 1: "a whole number", 2: "an odd number"}[self.step]
        return f"{kind} in {self.least:g}..{self.most:g}"

    def build(self, value: float) -> Defence:
        module, _, name = self.made_by.partition(":")
        return getattr(importlib.import_module(f"cloak_core.detectors.defended.{module}"), name)(value)


DEFENCES = {
    "jpeg": Kind(
        value="quality",
        least=1.0,
        most=100.0,
        step=1,
        made_by="detector:Jpeg",
        what="JPEG compression; attacked straight through (BPDA)",
    ),
    "blur": Kind(
        value="standard deviation in pixels",
        least=0.1,
        most=20.0,
        made_by="detector:Blur",
        what="Gaussian blur; differentiable",
    ),
    "median": Kind(
        value="side in pixels", least=3.0, most=9.0, step=2, made_by="detector:Median", what="median; differentiable"
    ),
    "bits": Kind(
        value="bits of a channel",
        least=1.0,
        most=8.0,
        step=1,
        made_by="detector:Bits",
        what="fewer levels of brightness; attacked straight through (BPDA)",
    ),
    "resize-pad": Kind(
        value="largest margin, a share of the image",
        least=0.01,
        most=0.6,
        usual=0.2,
        made_by="detector:ResizePad",
        what="random size and place; attacked in expectation, each step drawing anew (EOT)",
    ),
    "entropy-mask": Kind(
        value="bits",
        least=0.5,
        most=4.0,
        usual=3.5,  # what 99 % of the places in photographs lie below
        made_by="masking:EntropyMask",
        what="paints over what has too much entropy, after Jedi; attacked through its soft decision",
    ),
    "segment": Kind(
        value="probability",
        least=0.01,
        most=0.99,
        usual=0.5,
        made_by="masking:SegmenterMask",
        what="paints over what our own small network takes for a patch; attacked through its soft decision",
    ),
    "masked": Kind(
        value="side of the patch in pixels",
        least=1.0,
        most=4096.0,
        step=1,
        made_by="masks:Masks",
        what="reports what the image shows under any of 36 masks: a certified floor under one patch of this size",
    ),
}


def written(name: str) -> str:
    """Write a defence as it stands before a detector: "jpeg=QUALITY:SPEC"."""
    kind = DEFENCES[name]
    number = kind.value.split()[0].strip(",").upper()
    return f"{name}={number}:SPEC" if kind.usual is None else f"{name}[={number}]:SPEC"


def split_defence(spec: str) -> tuple[str, str] | None:
    """Split a spec that begins with a defence into (head, rest), "jpeg=75" and "builtin@224"; None for any other.

    InputError: no detector behind it.
    """
    head, _, rest = spec.partition(":")
    if head.partition("=")[0].partition("@")[0] not in DEFENCES:
        return None
    if not rest:
        raise InputError(f"detector {spec!r}: names no detector behind it; expected {written(head.partition('=')[0])}")
    return head, rest


def read_head(head: str, spec: str) -> tuple[str, float]:
    """Name and number of a defence; `spec` is the whole that an InputError names: no number, or one out of bounds."""
    name, mark, text = head.partition("=")
    kind = DEFENCES.get(name)
    if kind is None:
        raise InputError(f"detector {spec!r}: unknown defence {name!r}; known: {', '.join(DEFENCES)}")
    if not mark and kind.usual is not None:
        return name, kind.usual
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    fits = kind.least <= value <= kind.most
    if not fits or (kind.step is not None and (value - kind.least) % kind.step):
        raise InputError(f"detector {spec!r}: {head} must give its {kind.value}, {kind.bounds}, as {written(name)}")
    return name, value


def list_defences() -> list[dict]:
    """List the defences: [{"defence", "spec", "what"}, ...]."""
    return [{"defence": name, "spec": written(name), "what": kind.what} for name, kind in DEFENCES.items()]
