"""Printed intervals cover a known success rate, where a bootstrap alone does not."""

import json

import numpy as np
import pytest

from cloak_core.core.evaluation.intervals import clustered_rate
from tests.studies.simulated_evaluations import ASKED, Design, coverage, designs, least_width, simulate


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
