"""Photographs of people as training sees them: another part, scale, light and fit each time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Int64

from cloak_core.core.linear import SparseMap
from cloak_core.core.settings.people import PeopleSettings
from cloak_core.core.source import Dealt
from cloak_core.core.view import BakedView
from cloak_core.core.worn import Worn
from cloak_core.sources.photographs.fits import Fits
from cloak_core.sources.photographs.fitting import Fit
from cloak_core.sources.photographs.views import (
    Framing,
    Looseness,
    cloth_places,
    logo_positions,
    photograph_view,
    shares_of,
)

_ORDER = 4
"""Stream of random numbers, apart from those of `core.sampling`."""


_CLOTH = 1
"""Stream of random numbers of an image, beside the one of framing and looseness."""


@dataclass(frozen=True, eq=False)
class FitPlaces:
    """The `Places` of a fitted person's pixels. position: of the rig's triangles in the logo, see `logo_positions`."""

    fit: Fit
    position: Int64[np.ndarray, " T"]
    logo_count: int
    looseness: Looseness

    def faces(self) -> SparseMap:
        """See `Places`."""
        return shares_of(self.fit, self.position, self.logo_count, self.looseness)

    def cloth(self) -> tuple[Float[np.ndarray, "P 2"], Bool[np.ndarray, " P"]]:
        """See `Places`. As much wider or taller as a fit errs."""
        return cloth_places(self.fit) * self.looseness.stretch, self.position[self.fit.main] >= 0


class PeopleSource:
    """A `Source` of fitted people who wear something.

    `InputError`: the topology of what is worn is none that the rig knows.
    """

    directions, is_fresh = 1, True
    works_on = torch.device("cpu")

    def __init__(self, fits: Sequence[Fit], worn: Worn, settings: PeopleSettings, size: int, seed: int = 0) -> None:
        """seed: of the run, which decides in which order people are shown."""
        self.fits, self.worn, self.settings, self.size, self.seed = fits, worn, settings, size, seed
        self._last: tuple[int, np.ndarray] = -1, np.zeros(0, np.int64)
        self._position = logo_positions(worn.logo.topology, worn.logo.face_ids)

    @property
    def members(self) -> int:
        """People."""
        return len(self.fits)

    def draw(self, dealt: Dealt, random: np.random.Generator) -> dict[str, np.ndarray]:
        """See `Source`. Column `person`: everybody equally often, in random order."""
        if isinstance(self.fits, Fits):  # those of the next step are read from disk meanwhile
            self.fits.expect(self._people_of(dealt.images + len(dealt.images)).tolist())
        return {"person": self._people_of(dealt.images)}

    def _people_of(self, images: Int[np.ndarray, " B"]) -> Int64[np.ndarray, " B"]:
        rounds, places = np.divmod(images, self.members)
        orders = {r: self._order(r) for r in np.unique(rounds).tolist()}
        person = [orders[r][place] for r, place in zip(rounds.tolist(), places.tolist(), strict=True)]
        return np.array(person, np.int64)

    def _order(self, number: int) -> Int64[np.ndarray, " N"]:
        """The order in which a round shows everybody."""
        if self._last[0] != number:
            order = np.random.default_rng([self.seed, _ORDER, 0, number]).permutation(self.members)
            self._last = number, order
        return self._last[1]

    def view(self, shown: Mapping[str, int | float], seed: int) -> BakedView:
        """See `Source`."""
        person = int(shown["person"])
        fit, framing, looseness = self._drawn(person, seed)
        places = FitPlaces(fit, self._position, len(self.worn.logo), looseness)
        worn = self.worn.on_places(places, np.random.default_rng([seed, person, _CLOTH]))
        return photograph_view(fit, worn, framing, looseness)

    def undressed(self, shown: Mapping[str, int | float], seed: int) -> BakedView:
        """See `Source`: the photograph as it is."""
        fit, framing, _ = self._drawn(int(shown["person"]), seed)
        nothing = np.full_like(self._position, -1)
        return photograph_view(fit, shares_of(fit, nothing, len(self.worn.logo)), framing)

    def _drawn(self, person: int, seed: int) -> tuple[Fit, Framing, Looseness]:
        fit, random = self.fits[person], np.random.default_rng([seed, person])
        return fit, draw_framing(random, fit, self.settings, self.size), draw_looseness(random, self.settings)


def draw_framing(random: np.random.Generator, fit: Fit, settings: PeopleSettings, size: int) -> Framing:
    """A square about the person that keeps her box nearly whole, moved into the photograph where it fits there."""
    x0, y0, x1, y1 = fit.person.box
    tall = max(y1 - y0, x1 - x0)
    side = tall * random.uniform(settings.people_context.low, settings.people_context.high)
    away = random.uniform(-1, 1, 2)
    mirror, softness = bool(random.random() < settings.people_mirror), 1 + random.uniform(0, settings.people_soft)
    starts = []
    for low, high, most, move in (
        (x0, x1, fit.person.shape[1], away[0]),
        (y0, y1, fit.person.shape[0], away[1]),
    ):
        free = max(side - (high - low), 0) / 2 + settings.people_shift * tall
        start = (low + high - side) / 2 + move * min(free, 0.5 * side)
        starts.append(min(max(start, 0.0), most - side) if side <= most else (most - side) / 2)
    return Framing(starts[0], starts[1], side, size, mirror, softness)


def draw_looseness(random: np.random.Generator, settings: PeopleSettings) -> Looseness:
    """What the fit may have got wrong."""
    far, light = settings.people_loose, settings.people_light
    move, stretch = random.uniform(-far, far, 2), 1 + random.uniform(-2 * far, 2 * far, 2)
    folds, exposure = 1 + random.uniform(-2 * light, 2 * light), 1 + random.uniform(-light, light / 2)
    return Looseness(tuple(move.tolist()), tuple(stretch.tolist()), max(folds, 0.0), exposure)
