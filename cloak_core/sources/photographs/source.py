"""People in photographs: a source of views. Training sees another part, scale, light and fit each time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Int, Int64

from cloak_core.core.cameras import Number
from cloak_core.core.logo import Cover
from cloak_core.core.pattern import Pattern
from cloak_core.core.source import Dealt
from cloak_core.core.view import BakedView
from cloak_core.files.identity import sha256_record
from cloak_core.sources.photographs.fits import Fits, people_identity
from cloak_core.sources.photographs.fitting import Fit
from cloak_core.sources.photographs.views import (
    CONTEXT,
    FitJitter,
    Framing,
    framing_of,
    logo_positions,
    photograph_view,
    square_at,
)

_ORDER = 4
"""Stream of random numbers, apart from those of `core.sampling`."""


SIDE = (1.1, 2.0)
"""Of an image that trains, in heights of the person's box; as all below drawn uniformly for each image."""
SHIFT = 0.1
"""The person may stand anywhere that keeps her in the image, and be cut by up to this share of her height."""
MIRRORED = 0.5
"""Share of the photographs that are mirrored."""
LOOSE = 0.02
"""Faces lie off their fitted places by up to this many heights of the person, and are stretched by twice that."""
LIGHT = 0.3
"""Exposure of the cloak in the photograph changes by up to this share, the depth of folds by twice as much."""
SOFT = 0.8
"""The resampling kernel is wider by up to this much: softer lenses, lower resolution."""
_CLOTH = 1
"""Stream of random numbers of an image, beside the one of framing and looseness."""


class PeopleSource:
    """A `Source` of fitted people in photographs, as training draws them or as judging has them.

    `InputError`: the topology of what is worn is none that the rig knows.
    """

    directions, is_fresh = 1, True

    def __init__(
        self,
        fits: Fits,
        size: int,
        seed: int = 0,
        context: Number = CONTEXT,
        device: torch.device | str = "cpu",
    ) -> None:
        """seed: of the run, which decides in which order people are shown.

        context: side of the images that judge, in heights of the person's box.
        """
        self.fits, self.size, self.seed, self.context = fits, size, seed, context
        self.works_on = torch.device(device)
        self._last: tuple[int, np.ndarray] = -1, np.zeros(0, np.int64)
        self._positions: dict[str, Int64[np.ndarray, " T"]] = {}

    @cached_property
    def identity(self) -> str:
        """See `Source`."""
        return sha256_record([people_identity(self.fits.people), self.size, self.context])

    @property
    def members(self) -> int:
        """People."""
        return len(self.fits)

    def draw(self, dealt: Dealt, random: np.random.Generator) -> dict[str, np.ndarray]:
        """See `Source`. Column `person`: everybody equally often, in random order."""
        # Those of the next step are read from disk meanwhile.
        self.fits.expect(self._people_of(dealt.images + len(dealt.images)).tolist())
        return {"person": self._people_of(dealt.images)}

    def _people_of(self, images: Int[np.ndarray, " B"]) -> Int64[np.ndarray, " B"]:
        rounds, places = np.divmod(images, self.members)
        orders = {r: self._order(r) for r in np.unique(rounds).tolist()}
        return np.array([orders[r][place] for r, place in zip(rounds.tolist(), places.tolist(), strict=True)], np.int64)

    def _order(self, number: int) -> Int64[np.ndarray, " N"]:
        """Draw the order in which a round shows everybody."""
        if self._last[0] != number:
            order = np.random.default_rng([self.seed, _ORDER, 0, number]).permutation(self.members)
            self._last = number, order
        return self._last[1]

    def view(self, shown: Mapping[str, int | float], seed: int | None, pattern: Pattern) -> BakedView:
        """See `Source`."""
        person = int(shown["person"])
        fit = self.fits[person]
        place = fit, self._positions_of(pattern.cover), len(pattern.cover)
        if seed is None:
            return photograph_view(*place, framing_of(fit, self.context, self.size), device=self.works_on)
        random = np.random.default_rng([seed, person])
        framing = draw_framing(random, fit, self.size)
        # What the fit may have got wrong.
        move, stretch = random.uniform(-LOOSE, LOOSE, 2), 1 + random.uniform(-2 * LOOSE, 2 * LOOSE, 2)
        folds, exposure = 1 + random.uniform(-2 * LIGHT, 2 * LIGHT), 1 + random.uniform(-LIGHT, LIGHT / 2)
        jitter = FitJitter(tuple(move.tolist()), tuple(stretch.tolist()), max(folds, 0.0), exposure)
        view = photograph_view(*place, framing, jitter, self.works_on)
        return replace(view, stream=(seed, person, _CLOTH))

    def _positions_of(self, cover: Cover) -> Int64[np.ndarray, " T"]:
        if cover.key not in self._positions:
            self._positions[cover.key] = logo_positions(cover.topology, cover.face_ids)
        return self._positions[cover.key]

    def require_visible(self, pattern: Pattern) -> None:
        """See `Source`: everybody's clothes are seen, so that topologies decide."""
        self._positions_of(pattern.cover)


def draw_framing(random: np.random.Generator, fit: Fit, size: int) -> Framing:
    """A square about the person that keeps her box nearly whole, moved into the photograph where it fits there."""
    x0, y0, x1, y1 = fit.person.box
    tall = max(y1 - y0, x1 - x0)
    side = tall * random.uniform(*SIDE)
    away = random.uniform(-1, 1, 2)
    mirror, softness = bool(random.random() < MIRRORED), 1 + random.uniform(0, SOFT)

    def start(low: Number, high: Number, move: Number) -> Number:
        free = max(side - (high - low), 0) / 2 + SHIFT * tall
        return (low + high - side) / 2 + move * min(free, 0.5 * side)

    return Framing(*square_at(fit, start(x0, x1, away[0]), start(y0, y1, away[1]), side), side, size, mirror, softness)
