"""Intervals: degenerate cases are honest, and a known rate is covered, where a bootstrap alone does not cover it."""

import json

import numpy as np
import pytest
from scipy import stats

from cloak_core.core.evaluation.intervals import bootstrap_interval, cells, clustered_rate, wilson
from tests.studies.simulated_evaluations import ASKED, Design, coverage, designs, least_width, simulate


def test_wilson_against_scipy() -> None:
    expected = stats.binomtest(18, 20).proportion_ci(method="wilson")
    assert wilson(0.9, 20) == pytest.approx((expected.low, expected.high), rel=1e-9)


def test_all_successes_are_not_certain() -> None:
    """3 bodies x 4 backgrounds x 10 angles without a miss: a third of all people may still never be hidden."""
    body, background, _ = (a.ravel() for a in np.meshgrid(range(3), range(4), range(10)))
    rate = clustered_rate(np.ones(120, bool), body, background)
    assert (rate.value, rate.high, rate.n) == (1.0, 1.0, 120)
    assert rate.low == pytest.approx(0.05 ** (1 / 3)) and rate.low < wilson(1.0, 12)[0]


@pytest.mark.long
@pytest.mark.parametrize("seed_sd, body_sd, background_sd, mean", [(1.0, 1.0, 0.5, 0.0), (1.5, 0.5, 0.5, 2.0)])
def test_coverage_over_trainings(seed_sd: float, body_sd: float, background_sd: float, mean: float) -> None:
    """3 trainings x 4 bodies x 12 backgrounds: a bootstrap that takes trainings for more images covers less."""
    rng = np.random.default_rng(0)
    wide = rng.normal(size=(4, 100_000)) * [[seed_sd], [body_sd], [background_sd], [0.3]]
    truth = (1 / (1 + np.exp(-mean - wide.sum(0)))).mean()
    seed, body, background = (a.ravel() for a in np.meshgrid(range(3), range(4), range(12), indexing="ij"))
    clustered = tiled = 0
    for _ in range(200):
        effects = seed_sd * rng.normal(size=3)[seed] + body_sd * rng.normal(size=4)[body]
        effects += background_sd * rng.normal(size=12)[background] + 0.3 * rng.normal(size=144)
        hits = rng.random(144) < 1 / (1 + np.exp(-mean - effects))
        rate = clustered_rate(hits, body, background, seed, resamples=100)
        clustered += rate.low <= truth <= rate.high
        low, high = bootstrap_interval(*cells(hits, [0 * seed, body, background]), 100, rng)
        tiled += low <= truth <= high
    assert clustered / 200 >= 0.93
    assert tiled < clustered - 10


def test_trainings_that_differ_widen_the_interval_and_one_alone_does_not() -> None:
    body, background = (a.ravel() for a in np.meshgrid(range(4), range(30), indexing="ij"))
    hits = np.random.default_rng(0).random(120) < 0.5
    alone = clustered_rate(hits, body, background)
    assert clustered_rate(hits, body, background, np.zeros(120, int)) == alone
    seeds = np.repeat([0, 1, 2], 120)
    different = np.concatenate([hits, np.ones(120, bool), np.zeros(120, bool)])
    rate = clustered_rate(different, np.tile(body, 3), np.tile(background, 3), seeds)
    assert rate.high - rate.low > 1.5 * (alone.high - alone.low)


@pytest.mark.slow
def test_designs_draw_the_rate_they_promise() -> None:
    for design in (Design(16, 12, 1, 0.966, 2.0, 0.0), Design(8, 6, 3, 0.97, 0.5, 0.1)):
        rng = np.random.default_rng(0)
        rate = np.mean([simulate(design, rng).hits.mean() for _ in range(600)])
        assert rate == pytest.approx(design.target, abs=0.015)
    assert len({json.dumps(vars(design)) for design in designs()}) == len(list(designs())) >= 80


@pytest.mark.slow
@pytest.mark.parametrize(
    "design",
    [
        Design(6, 12, 1, 0.9, 3.0, 0.0),
        Design(8, 6, 1, 0.995, 0.5, 0.1),
        Design(16, 6, 3, 0.995, 0.5, 0.05),
        Design(16, 12, 1, 0.966, 3.0, 0.0),
    ],
    ids=str,
)
def test_intervals_cover_where_the_bootstrap_does_not(design: Design) -> None:
    found = coverage(design, 60)
    assert found["ours"]["coverage"] >= 0.93
    assert found["bootstrap"]["coverage"] <= 0.93
    assert found["ours"]["width"] < found["Korn-Graubard"]["width"]


@pytest.mark.parametrize("bodies", [4, 6, 8, 16])
def test_what_is_printed_is_not_much_wider_than_any_honest_interval(bodies: int) -> None:
    body, background = (way.ravel() for way in np.indices((bodies, 12)))
    rate = clustered_rate(np.ones(body.size, bool), body, background)
    assert 0 < (rate.high - rate.low) - least_width(bodies, ASKED) < 0.05
