"""What a pattern is compared with, on the same faces in the same images.

A high success means little when any odd patch would have done as well. So beside it stand own clothing, plain grey,
random colours, own clothing brought onto the faces and back, and two natural patterns as strong as the judged one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from cloak_core.core.evaluation import CLOTHING, NAMES, NATURAL, RESAMPLED, STANDARD
from cloak_core.core.geometry import face_centres
from cloak_core.core.linear import SparseMap
from cloak_core.core.pattern import Pattern
from cloak_core.core.places import Places
from cloak_core.core.view import BakedView
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.patterns.faces import FacePattern

STRIPE = 0.05
"""Width of a stripe or check, metres."""


@dataclass(frozen=True, eq=False)
class OwnClothing(FacePattern):
    """What a body wears by itself; a photograph shows it without any face laid onto it."""

    def map(self, places: Places, offset: tuple[float, float] = (0.0, 0.0)) -> SparseMap:
        return places.own

    def colors_in(self, view: BakedView, image: int) -> Float32[Tensor, "L 3"]:
        return view.own


@dataclass(frozen=True, eq=False)
class Resampled(FacePattern):
    """Own clothing, brought onto the faces and back: what laying colours onto faces alone does to a detector."""

    def colors_in(self, view: BakedView, image: int) -> Float32[Tensor, "L 3"]:
        shares, seen = view.places.shares, view.seen
        return (shares.adjoint(seen) / shares.adjoint(torch.ones_like(seen)).clamp(min=1e-9)).clamp(0, 1)


@dataclass(frozen=True, eq=False)
class RandomColors(FacePattern):
    """Uniform random colours of faces, others in each image, from a seed and the image's number alone."""

    seed: int = 0

    @property
    def identity(self) -> str:
        return sha256_record([type(self).__name__, self.cover.key, self.seed])

    def colors_in(self, view: BakedView, image: int) -> Float32[Tensor, "L 3"]:
        drawn = np.random.default_rng([self.seed, image]).random((self.count, 3), np.float32)
        return torch.from_numpy(drawn).to(view.pixels.device)


def controls(names: Sequence[str], judged: Pattern, seed: int = 0, bodies: Bodies | None = None) -> dict[str, Pattern]:
    """Make the controls of these names for the faces that `judged` covers. InputError: a name is none.

    bodies: what stripes and checks, which are as strong as the judged colours, are drawn on.
    """
    cover = judged.cover
    made = {
        CLOTHING: lambda: OwnClothing(cover),
        "grey": lambda: FacePattern(cover, colors=np.full((len(cover), 3), 0.5, np.float32)),
        "random": lambda: RandomColors(cover, seed=seed),
        RESAMPLED: lambda: Resampled(cover),
    }
    if bodies is not None:
        made |= {name: lambda name=name: _two_tone(judged, name, bodies) for name in NATURAL}
    if unknown := [name for name in names if name not in made]:
        known = NAMES if bodies is not None else (*STANDARD, RESAMPLED)
        raise InputError(f"--controls: {unknown[0]!r}: there are {', '.join(known)}")
    return {name: made[name]() for name in names}


def _two_tone(judged: Pattern, name: str, bodies: Bodies) -> FacePattern:
    """Make two greys about mid-grey with the judged colours' standard deviation of luminance.

    Stripes run around the body, checks cross them in x and y.
    """
    contrast = min(0.5, float((judged.colors @ np.array([0.2126, 0.7152, 0.0722], np.float32)).std()))
    cell = np.floor(face_centres(bodies)[judged.cover.face_ids] / STRIPE).astype(np.int64)
    light = (cell[:, 1] if name == "stripes" else cell[:, 0] + cell[:, 1]) % 2 == 0
    greys = np.where(light[:, None], 0.5 + contrast, 0.5 - contrast).astype(np.float32)
    return FacePattern(judged.cover, colors=greys.repeat(3, 1))
