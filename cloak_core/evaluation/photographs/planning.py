"""How many photographs an interval of a given width takes, by simulation of what `counting` will compute."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

from cloak_core.evaluation.intervals import clustered_rate, wilson

ALIKE = 0.1
"""How much of the difference between pictures (latent variance) the person decides, and the scene likewise."""
PEOPLE, SCENES, EACH = (1, 2, 4, 8, 12), (2, 4, 8, 12), (1, 3)
RATES = (0.5, 0.9)


def plan(
    people: Sequence[int] = PEOPLE,
    scenes: Sequence[int] = SCENES,
    each: Sequence[int] = EACH,
    rates: Sequence[float] = RATES,
    *,
    alike: float = ALIKE,
    draws: int = 20,
    resamples: int = 200,
    seed: int = 0,
) -> list[dict]:
    """For every number of people, of scenes and of pairs of pictures of each person in each scene: half the width of
    the 95 % interval about each true rate, the mean over simulated campaigns, in points.

    Pictures of one person, and of one scene, are alike: a normal latent variable has a share `alike` of its variance
    from the person and another from the scene.
    """
    rows = []
    for count in people:
        for places in scenes:
            for pictures in each:
                half = {
                    rate: _half_width(count, places, pictures, rate, alike, draws, resamples, seed) for rate in rates
                }
                pairs = count * places * pictures
                points = {f"{rate:g}": round(100 * value, 1) for rate, value in half.items()}
                rows.append({"people": count, "scenes": places, "each": pictures, "pairs": pairs, "points": points})
    return rows


def independent(rate: float, half: float = 0.1) -> int:
    """Pairs that would do if no two of them had a person or a scene in common: Wilson's interval."""
    return next(n for n in range(1, 100_000) if np.ptp(wilson(rate, n)) / 2 <= half)


def _half_width(
    people: int, scenes: int, each: int, rate: float, alike: float, draws: int, resamples: int, seed: int
) -> float:
    rng = np.random.default_rng([seed, people, scenes, each])
    person, place, _ = (axis.ravel() for axis in np.meshgrid(*map(np.arange, (people, scenes, each)), indexing="ij"))
    cut, widths = NormalDist().inv_cdf(rate), []
    for draw in range(draws):
        latent = math.sqrt(alike) * (rng.normal(size=people)[person] + rng.normal(size=scenes)[place])
        latent = latent + math.sqrt(1 - 2 * alike) * rng.normal(size=len(person))
        found = clustered_rate(latent < cut, person, place, resamples=resamples, seed=draw)
        widths.append((found.high - found.low) / 2)
    return float(np.mean(widths))
