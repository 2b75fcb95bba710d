"""Simulate evaluations with a known success rate and count how often printed 95 % intervals cover it.

`python -m tests.studies.simulated_evaluations 200 > records/intervals.csv` writes the record of its report.
"""

from __future__ import annotations

import csv
import itertools
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields
from typing import TextIO

import numpy as np
from jaxtyping import Bool, Int64
from scipy.optimize import brentq
from scipy.special import expit
from scipy.stats import beta

from cloak_core.core.evaluation.intervals import bootstrap_interval, cells, clustered_deviation, clustered_rate

IMAGES = 336
"""Images of one evaluation and training, dealt out to its bodies."""
BACKGROUND_SD = 0.5
RESAMPLES = 300
Bounds = tuple[float, float]


@dataclass(frozen=True)
class Design:
    """How one evaluation is made up, and how success varies in it."""

    bodies: int
    backgrounds: int
    seeds: int
    truth: float
    """Success rate of bodies that are not always found."""
    body_sd: float
    """Standard deviation between bodies, logits."""
    never_hidden: float
    """Share of all people whom the detector always finds."""

    @property
    def target(self) -> float:
        """The success rate over all people: what an interval should cover."""
        return self.truth * (1 - self.never_hidden)


@dataclass(frozen=True)
class Draw:
    """The images of one simulated evaluation [N]."""

    hits: Bool[np.ndarray, " N"]
    body: Int64[np.ndarray, " N"]
    background: Int64[np.ndarray, " N"]
    seed: Int64[np.ndarray, " N"]


def designs() -> Iterator[Design]:
    """Yield all designs of the published record."""
    sizes = ((4, 3, 1), (6, 12, 1), (16, 12, 1), (16, 3, 1), (8, 6, 3))
    for size, truth, sd in itertools.product(sizes, (0.9, 0.966, 0.995), (0.0, 1.0, 2.0, 3.0)):
        yield Design(*size, truth, sd, 0.0)
    for bodies, seeds, truth, never_hidden in itertools.product((4, 8, 16), (1, 3), (0.97, 0.995), (0.05, 0.1)):
        yield Design(bodies, 6, seeds, truth, 0.5, never_hidden)


def simulate(design: Design, rng: np.random.Generator) -> Draw:
    """Draw one evaluation: logit(p) = mean + body + background, and bodies that are never hidden."""
    mean = _mean_logit(design.truth, float(np.hypot(design.body_sd, BACKGROUND_SD)))
    body = np.tile(np.arange(IMAGES) % design.bodies, design.seeds)
    background = rng.integers(design.backgrounds, size=len(body))
    effect = design.body_sd * rng.normal(size=design.bodies)
    chance = expit(mean + effect[body] + BACKGROUND_SD * rng.normal(size=design.backgrounds)[background])
    chance[(rng.random(design.bodies) < design.never_hidden)[body]] = 0
    return Draw(rng.random(len(body)) < chance, body, background, np.repeat(np.arange(design.seeds), IMAGES))


def _mean_logit(truth: float, sd: float) -> float:
    """Find the mean whose logistic-normal expectation is `truth` (Gauss-Hermite quadrature)."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(61)
    return brentq(lambda mean: (expit(mean + sd * nodes) * weights).sum() / weights.sum() - truth, -10, 80)


def bootstrap(draw: Draw) -> Bounds:
    """Compute the stretched pigeonhole bootstrap's interval alone."""
    hit, count = cells(draw.hits, [draw.seed, draw.body, draw.background])
    return bootstrap_interval(hit, count, RESAMPLES, np.random.default_rng(0))


def korn_graubard(draw: Draw) -> Bounds:
    """Compute the exact binomial interval at the effective size (Korn and Graubard, Survey Methodology 24, 1998).

    The effective size is at most the number of bodies: images of one body are no independent draws.
    """
    hit, count = cells(draw.hits, [draw.seed, draw.body, draw.background])
    n = count.sum()
    p = hit.sum() / count.sum()
    deviation = clustered_deviation(hit - p * count) / n
    bodies = len(np.unique(draw.body))
    size = min(bodies, p * (1 - p) / deviation**2) if deviation else bodies
    hits = p * size
    low = beta.ppf(0.025, hits, size - hits + 1) if hits > 0 else 0.0
    high = beta.ppf(0.975, hits + 1, size - hits) if hits < size else 1.0
    return float(low), float(high)


def ours(draw: Draw) -> Bounds:
    """Compute the interval that every report prints: `clustered_rate`."""
    rate = clustered_rate(draw.hits, draw.body, draw.background, draw.seed, resamples=RESAMPLES)
    return rate.low, rate.high


ASKED = 0.93
"""Coverage that is asked of every design."""
METHODS: dict[str, Callable[[Draw], Bounds]] = {"bootstrap": bootstrap, "Korn-Graubard": korn_graubard, "ours": ours}


def coverage(design: Design, repetitions: int, seed: int = 0) -> dict[str, dict[str, float]]:
    """Count, for every method, how often its interval covers the design's target, and its mean width."""
    rng = np.random.default_rng([seed, *(int(1000 * value) for value in asdict(design).values())])
    outcomes = {name: [] for name in METHODS}
    for _ in range(repetitions):
        draw = simulate(design, rng)
        for name, method in METHODS.items():
            low, high = method(draw)
            outcomes[name].append((low <= design.target <= high, high - low))
    means = {name: np.mean(values, axis=0) for name, values in outcomes.items()}
    return {name: {"coverage": float(hit), "width": float(width)} for name, (hit, width) in means.items()}


def least_width(bodies: int, covers: float) -> float:
    """Compute the least width at a success of 1 of any interval that covers in this share, whoever else there is.

    Where a share q of all people is never hidden, the tested bodies hold none of them with probability (1 - q)^bodies,
    and then look like people all of whom are hidden. So the interval of such an outcome must reach down to 1 - q for
    every q for which that happens more often than it may miss.
    """
    return 1 - (1 - covers) ** (1 / bodies)


def write_record(repetitions: int, file: TextIO) -> None:
    """Simulate every design, and write a row of CSV for each: the design, and coverage and mean width by method."""
    writer = csv.writer(file, lineterminator="\n")
    measures = [(name, key) for name in METHODS for key in ("coverage", "width")]
    writer.writerow([*(field.name for field in fields(Design)), *(f"{name} {key}" for name, key in measures)])
    for design in designs():
        found = coverage(design, repetitions)
        numbers = [f"{value:g}" for value in asdict(design).values()]
        writer.writerow([*numbers, *(f"{found[name][key]:.2f}" for name, key in measures)])


if __name__ == "__main__":
    write_record(int(sys.argv[1]), sys.stdout)
