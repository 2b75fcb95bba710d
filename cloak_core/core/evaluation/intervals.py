"""Confidence intervals for success rates over images that share bodies, backgrounds and trainings.

Images of one body, on one background, or of one training succeed and fail together, so they are not independent draws
and a binomial interval is far too narrow. The interval is the widest of three:

- A pigeonhole bootstrap (Owen, "The pigeonhole bootstrap", Annals of Applied Statistics 1(2), 2007): bodies,
  backgrounds and seeds are each drawn again with replacement, and an image counts as often as its body times its
  background times its seed was drawn. The bootstrap underestimates the variance between n clusters by (n - 1) / n and
  ignores that variance's own uncertainty. So its percentiles are moved from or to the estimate until their spread is
  the multiway clustered one (Cameron, Gelbach and Miller, JBES 29(2), 2011): the variances of bodies, backgrounds and
  seeds, each with n / (n - 1) and (t(n - 1) / z)^2, minus those of their pairs, plus that of the triples; never less
  than the largest single one.
- Wilson's interval for as many independent draws as there are distinct (body, background) pairs: where every image
  came out alike, a bootstrap reports no uncertainty at all. Another training on the same pair is no new image.
- What bodies unlike any of the tested ones could change. Where a share q of all people is never hidden (or always),
  n tested bodies hold none of them with probability (1 - q)^n; at q = 1 - 0.05^(1/n) that is one time in twenty (the
  exact zero-event bound; Hanley and Lippman-Hand, JAMA 249(13), 1983). The interval reaches from p (1 - q) to
  p + (1 - p) q. Without this part, intervals at rates near 1 covered the truth 48 to 85 times in 100 where one
  body in ten is never hidden; with it, at least 98 times (docs/reports/intervals.md).

With one body (or one background, or one seed) nothing can be said about others: the interval then speaks of that one
alone.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from jaxtyping import Bool, Float, Integer
from scipy.special import stdtrit

RESAMPLES = 1000
LEVEL = 0.95
_Z = NormalDist().inv_cdf((1 + LEVEL) / 2)


@dataclass(frozen=True)
class Rate:
    """A share of images with its interval; `value` and the bounds are nan where there is no image."""

    value: float
    low: float
    high: float
    n: int


def clustered_rate(
    hits: Bool[np.ndarray, " N"] | Float[np.ndarray, " N"],
    bodies: Integer[np.ndarray, " N"],
    backgrounds: Integer[np.ndarray, " N"],
    seeds: Integer[np.ndarray, " N"] | None = None,
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Rate:
    """Compute the share of `hits` with its interval over bodies, backgrounds and, where given, seeds (labels).

    A hit may also be a part of one, in [0, 1].
    """
    n = len(hits)
    if not n:
        return Rate(math.nan, math.nan, math.nan, 0)
    hit, count = cells(hits, [np.zeros(n, int) if seeds is None else seeds, bodies, backgrounds])
    value = float(hit.sum() / n)
    bounds = [
        bootstrap_interval(hit, count, resamples, np.random.default_rng(seed)),
        wilson(value, int((count.sum(0) > 0).sum())),
        unseen_bodies(value, len(np.unique(bodies))),
    ]
    low, high = min(low for low, _ in bounds), max(high for _, high in bounds)
    return Rate(value, float(low), float(high), n)


def wilson(value: float, n: int) -> tuple[float, float]:
    """Compute Wilson's score interval for a share `value` of `n` independent draws."""
    centre = (value + _Z * _Z / (2 * n)) / (1 + _Z * _Z / n)
    half = _Z / (1 + _Z * _Z / n) * math.sqrt(value * (1 - value) / n + _Z * _Z / (4 * n * n))
    return max(0.0, centre - half), min(1.0, centre + half)


def unseen_bodies(value: float, bodies: int) -> tuple[float, float]:
    """Bound a rate by what people unlike every tested body could change."""
    unlike = 1 - (1 - LEVEL) ** (1 / bodies) if bodies > 1 else 0.0
    return value * (1 - unlike), value + (1 - value) * unlike


def cells(hits: np.ndarray, labels: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Count hits and images of every cell, float [seeds, bodies, backgrounds] each."""
    columns = [np.unique(label, return_inverse=True)[1].ravel() for label in labels]
    shape = tuple(int(column.max()) + 1 for column in columns)
    flat = np.ravel_multi_index(columns, shape)
    size = math.prod(shape)
    hit = np.bincount(flat, weights=hits, minlength=size).reshape(shape)
    return hit, np.bincount(flat, minlength=size).reshape(shape).astype(float)


def bootstrap_interval(
    hit: np.ndarray, count: np.ndarray, resamples: int, rng: np.random.Generator
) -> tuple[float, float]:
    """Compute the pigeonhole bootstrap's interval, stretched to the multiway clustered deviation."""
    value = hit.sum() / count.sum()
    n = count.sum()
    draws = _pigeonhole(hit, count, resamples, rng)
    low, high = np.quantile(draws, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    stretch = clustered_deviation(hit - value * count) / n / max(float(draws.std()), 1e-12)
    return max(0.0, value - stretch * (value - low)), min(1.0, value + stretch * (high - value))


def _pigeonhole(hit: np.ndarray, count: np.ndarray, resamples: int, rng: np.random.Generator) -> np.ndarray:
    """Compute rates of resamples that draw every way's clusters anew; resamples without any image are left out."""
    seeds, bodies, backgrounds = hit.shape
    weights = [rng.multinomial(n, np.full(n, 1 / n), resamples) for n in (bodies, backgrounds, seeds)]

    def drawn(cells: np.ndarray) -> np.ndarray:
        by_seed = [((weights[0] @ part) * weights[1]).sum(1) for part in cells]
        return (weights[2] * np.stack(by_seed, 1)).sum(1)

    images, hits = drawn(count), drawn(hit)
    some = images > 0
    return hits[some] / images[some] if some.any() else np.array([hit.sum() / count.sum()])


def clustered_deviation(residual: np.ndarray) -> float:
    """Compute the multiway clustered deviation of the number of hits; `residual` is each cell's excess."""
    axes = [axis for axis, n in enumerate(residual.shape) if n > 1]
    variance, largest = 0.0, 0.0
    for order in range(1, len(axes) + 1):
        for kept in itertools.combinations(axes, order):
            others = tuple(axis for axis in range(residual.ndim) if axis not in kept)
            part = float((residual.sum(others) ** 2).sum())
            if order == 1:
                n = residual.shape[kept[0]]
                part *= n / (n - 1) * (stdtrit(n - 1, (1 + LEVEL) / 2) / _Z) ** 2
                largest = max(largest, part)
            variance += part if order % 2 else -part
    return math.sqrt(max(variance, largest))
