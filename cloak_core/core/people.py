"""Photographs of people as training sees them: another part, scale, light and fit each time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cloak_core.core.cloth import Cloth
from cloak_core.core.logo import Logo
from cloak_core.core.settings.people import PeopleSettings
from cloak_core.core.view import BakedView
from cloak_core.sources.photographs.fitting import Fit
from cloak_core.sources.photographs.views import (
    Framing,
    Looseness,
    cloth_places,
    cloth_shares,
    logo_positions,
    photograph_view,
    shares_of,
)

_CLOTH = 1
"""Stream of random numbers, beside the one of framing and looseness."""


class PeopleViews:
    """Views of fitted people who wear one logo, or a cloth over it.

    `InputError`: the logo's topology is none that the rig knows.
    """

    def __init__(
        self, fits: Sequence[Fit], logo: Logo, settings: PeopleSettings, size: int, cloth: Cloth | None = None
    ) -> None:
        self.fits, self.settings, self.size, self.cloth = tuple(fits), settings, size, cloth
        self._position = logo_positions(logo.topology, logo.face_ids)
        self._count = len(logo)

    def __len__(self) -> int:
        return len(self.fits)

    def view(self, person: int, seed: int) -> BakedView:
        """A view of one person; all that is random about it follows from `seed`."""
        fit, framing, looseness = self._drawn(person, seed)
        if self.cloth is None:
            shares = shares_of(fit, self._position, self._count, looseness)
        else:
            # Nobody cuts cloth in one place: it is laid anywhere, and as much wider or taller as a fit errs.
            away = np.random.default_rng([seed, person, _CLOTH]).uniform(0, self.cloth.metres, 2)
            places = cloth_places(fit) * looseness.stretch + away
            shares = cloth_shares(fit, self._position, self.cloth, places)
        return photograph_view(fit, shares, framing, looseness)

    def undressed(self, person: int, seed: int) -> BakedView:
        """The same view of the photograph as it is: no face of the logo is in it."""
        fit, framing, _ = self._drawn(person, seed)
        return photograph_view(fit, shares_of(fit, np.full_like(self._position, -1), self._count), framing)

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
        (x0, x1, fit.person.mask.shape[1], away[0]),
        (y0, y1, fit.person.mask.shape[0], away[1]),
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
