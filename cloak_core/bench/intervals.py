"""Simulate evaluations with a known success rate and count how often printed 95 % intervals cover it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Bool, Int64
from scipy.optimize import brentq
from scipy.special import expit
from scipy.stats import beta

from cloak_core.bench.records import table
from cloak_core.core.evaluation.intervals import bootstrap_interval, cells, clustered_deviation, clustered_rate
from cloak_core.core.evaluation.measure import OnProgress

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
    """Yield all designs of the published table."""
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
    return bootstrap_interval(hit, count, RESAMPLES, 0.95, np.random.default_rng(0))


def korn_graubard(draw: Draw) -> Bounds:
    """Compute the exact binomial interval at the effective size (Korn and Graubard, Survey Methodology 24, 1998).

    The effective size is at most the number of bodies: images of one body are no independent draws.
    """
    hit, count = cells(draw.hits, [draw.seed, draw.body, draw.background])
    n = count.sum()
    p = hit.sum() / count.sum()
    deviation = clustered_deviation(hit - p * count, 0.95) / n
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


def run_bench_intervals(repetitions: int = 200, on_progress: OnProgress = lambda done, total: None) -> dict:
    """Simulate every design; returns {"repetitions", "rows": [design and methods], "worst": {METHOD: coverage}}."""
    rows, every = [], tuple(designs())
    for number, design in enumerate(every):
        on_progress(number, len(every))
        rows.append(asdict(design) | {"methods": coverage(design, repetitions)})
    worst = {name: min(row["methods"][name]["coverage"] for row in rows) for name in METHODS}
    return {"repetitions": repetitions, "images": IMAGES, "rows": rows, "worst": worst}


def intervals_page(result: dict, command: str) -> str:
    """Write the page docs/reports/intervals.md: what was simulated, and a row for each design."""
    worst = ", ".join(f"{name} {100 * value:.0f} %" for name, value in result["worst"].items())
    heads = ["bodies", "backgrounds", "seeds", "success", "sd between bodies", "never hidden"]
    heads += [f"{name}: covers, width" for name in METHODS]
    rows = [
        [
            *(f"{row[key]:g}" for key in ("bodies", "backgrounds", "seeds", "truth", "body_sd", "never_hidden")),
            *(f"{100 * m['coverage']:.0f} %, {m['width']:.2f}" for m in row["methods"].values()),
        ]
        for row in result["rows"]
    ]
    counts = sorted({row["bodies"] for row in result["rows"]})
    least = ", ".join(f"{least_width(n, ASKED):.2f} with {n} bodies" for n in counts)
    text = [
        "# Do 95 % intervals hold?",
        "",
        "Evaluations with a known success rate are simulated; the table says how often the printed interval covers "
        f"that rate, and how wide it is on average. Each of {result['repetitions']} repetitions of a design draws "
        f"bodies, backgrounds ({BACKGROUND_SD} logits apart) and {result['images']} images a training. *Never hidden* "
        "is the share of all people whom the detector always finds, whatever they wear.",
        "",
        f"Lowest coverage of all designs: {worst}.",
        "",
        "`bootstrap` is the pigeonhole bootstrap with a multiway clustered deviation, `Korn-Graubard` an exact "
        "binomial interval at the effective sample size, `ours` what every report prints: the bootstrap's interval, "
        "widened by what people unlike any of the tested bodies could change "
        "(`cloak_core/core/evaluation/intervals.py`).",
        "",
        "The width is not caution: no method can be much narrower. Where a share q of all people is never hidden, n "
        "tested bodies hold none of them with probability (1 - q)^n, and the evaluation looks as if everybody were "
        f"hidden. An interval that covers {100 * ASKED:.0f} times in 100 whatever q is must then reach down to 1 - q "
        f"for every q of which that probability exceeds {100 * (1 - ASKED):.0f} %. So at a success of 1 its width is "
        f"at least {least}. More bodies make it narrower; more images do not.",
        "",
        *table(heads, rows),
        "",
        f"`{command}`",
    ]
    return "\n".join(text) + "\n"
