"""Confidence intervals for success rates over images that share bodies and backgrounds.

Images of one body, or on one background, succeed and fail together, so they are not independent draws and a binomial
interval is far too narrow. The interval here is a pigeonhole bootstrap (Owen, "The pigeonhole bootstrap", Annals of
Applied Statistics 1(2), 2007): bodies and backgrounds are each drawn again with replacement, and an image counts as
often as its body times its background was drawn. Two corrections make it hold for the few bodies one has:

- The bootstrap counts what is an image's own up to three times, sees the variance between n bodies too small by
  (n - 1) / n, and knows nothing of that variance's own uncertainty. So its percentiles, which give the shape, are moved
  from or to the estimate until their spread is the two-way clustered one: bodies' variance + backgrounds' - pairs' own
  (Cameron, Gelbach and Miller, JBES 29(2), 2011), bodies and backgrounds each with n / (n - 1) and t(n - 1) / z.
- Where every image came out alike a bootstrap reports no doubt at all. The interval is therefore never narrower than
  Wilson's for as many independent draws as there are distinct (body, background) pairs.

With one body (or one background) nothing can be said about others: the interval then speaks of that body alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import numpy as np

RESAMPLES = 1000
LEVEL = 0.95


@dataclass(frozen=True)
class Rate:
    """A share of images with its interval; `value` and the bounds are nan where there is no image."""

    value: float
    low: float
    high: float
    n: int


def two_way_rate(
    hits: np.ndarray,
    bodies: np.ndarray,
    backgrounds: np.ndarray,
    *,
    resamples: int = RESAMPLES,
    level: float = LEVEL,
    seed: int = 0,
) -> Rate:
    """Share of `hits` (bool [N]) with its interval over bodies and backgrounds (integer labels [N] each)."""
    n = len(hits)
    if not n:
        return Rate(math.nan, math.nan, math.nan, 0)
    hit, count = _cells(np.asarray(hits, bool), bodies, backgrounds)
    value = float(hit.sum() / n)
    draws = _pigeonhole(hit, count, resamples, np.random.default_rng(seed))
    low, high = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2])
    stretch = _two_way_deviation(hit - value * count, level) / n / max(float(draws.std()), 1e-12)
    wilson_low, wilson_high = wilson(value, int((count > 0).sum()), level)
    low = min(max(0.0, value - stretch * (value - low)), wilson_low)
    high = max(min(1.0, value + stretch * (high - value)), wilson_high)
    return Rate(value, float(low), float(high), n)


def wilson(value: float, n: int, level: float = LEVEL) -> tuple[float, float]:
    """Wilson's score interval for a share `value` of `n` independent draws."""
    z = NormalDist().inv_cdf((1 + level) / 2)
    centre = (value + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(value * (1 - value) / n + z * z / (4 * n * n))
    return max(0.0, centre - half), min(1.0, centre + half)


def _cells(hits: np.ndarray, bodies: np.ndarray, backgrounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hits and images of every (body, background) pair, float [bodies, backgrounds] each."""
    _, row = np.unique(bodies, return_inverse=True)
    _, column = np.unique(backgrounds, return_inverse=True)
    shape = (row.max() + 1, column.max() + 1)
    flat = row * shape[1] + column
    size = shape[0] * shape[1]
    hit = np.bincount(flat, weights=hits, minlength=size).reshape(shape)
    return hit, np.bincount(flat, minlength=size).reshape(shape).astype(float)


def _pigeonhole(hit: np.ndarray, count: np.ndarray, resamples: int, rng: np.random.Generator) -> np.ndarray:
    """Rates of resamples in which bodies and backgrounds are drawn anew; those that drew no image are left out."""
    rows, columns = hit.shape
    row_weight = rng.multinomial(rows, np.full(rows, 1 / rows), resamples)
    column_weight = rng.multinomial(columns, np.full(columns, 1 / columns), resamples)
    images = ((row_weight @ count) * column_weight).sum(1)
    hits = ((row_weight @ hit) * column_weight).sum(1)
    drawn = images > 0
    return hits[drawn] / images[drawn] if drawn.any() else np.array([hit.sum() / count.sum()])


def _two_way_deviation(residual: np.ndarray, level: float) -> float:
    """Clustered standard deviation of the number of hits; `residual` [bodies, backgrounds] is each pair's excess."""
    z = NormalDist().inv_cdf((1 + level) / 2)
    parts = []
    for axis in (0, 1):
        n = residual.shape[axis]
        widen = n / (n - 1) * (student_t(n - 1, (1 + level) / 2) / z) ** 2 if n > 1 else 0.0
        parts.append(widen * float((residual.sum(1 - axis) ** 2).sum()))
    return math.sqrt(max(sum(parts) - float((residual**2).sum()), *parts))


@lru_cache
def student_t(freedom: int, probability: float) -> float:
    """Quantile of Student's t distribution (probability > 0.5), by bisection of its exact distribution function."""
    low, high = 0.0, 1.0
    while _t_cdf(high, freedom) < probability:
        high *= 2
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if _t_cdf(middle, freedom) < probability else (low, middle)
    return (low + high) / 2


def _t_cdf(t: float, freedom: int) -> float:
    """P(T <= t) for t >= 0: the finite series of Abramowitz and Stegun 26.7.3 and 26.7.4."""
    theta = math.atan(t / math.sqrt(freedom))
    cos2 = math.cos(theta) ** 2
    if freedom % 2:
        term = total = math.cos(theta) if freedom > 1 else 0.0
        for k in range(3, freedom - 1, 2):
            term *= cos2 * (k - 1) / k
            total += term
        within = 2 / math.pi * (theta + math.sin(theta) * total)
    else:
        term = total = 1.0
        for k in range(2, freedom - 1, 2):
            term *= cos2 * (k - 1) / k
            total += term
        within = math.sin(theta) * total
    return 0.5 + within / 2
