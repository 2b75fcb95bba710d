"""Detectors that still see the person count most, or are asked most often."""

import numpy as np
import pytest
import torch

from cloak_core.core.ensemble import Ensemble
from cloak_core.techniques.adaptive import Adaptive
from tests.core.fakes import TinyDetector, techniques_of, tiny_settings


def ensemble_of(count: int, **changes: object) -> tuple[Ensemble, Adaptive]:
    settings = tiny_settings(ensemble="adaptive", **changes)
    techniques = techniques_of(settings, [TinyDetector(k) for k in range(count)])
    return Ensemble(settings.objective, count, techniques=techniques), techniques[0]


def test_a_level_is_one_half_at_the_operating_point():
    scores = torch.tensor([0.0, 0.25, 0.6, 1.0])
    assert Adaptive(1).level(scores, 0.25).tolist() == pytest.approx([0, 0.5, 9 / 11, 1])
    assert Adaptive(1).level(scores, 0.6).tolist() == pytest.approx([0, 2 / 11, 0.5, 1])


def test_an_adaptive_ensemble_weighs_most_what_still_sees():
    ensemble, adaptive = ensemble_of(3)
    assert ensemble.weights.tolist() == pytest.approx([1 / 3] * 3)
    for _ in range(60):
        adaptive.observe({0: 0.0, 1: 0.2, 2: 1.0})
    assert ensemble.weights.sum() == pytest.approx(1)
    assert ensemble.weights[2] > 0.9 and ensemble.weights[1] > ensemble.weights[0] > 0
    assert ensemble.weight(2, asked=3) == pytest.approx(ensemble.weights[2])
    other = Adaptive(3)
    other.load(adaptive.state())
    assert np.array_equal(other.weights(), adaptive.weights())
    with pytest.raises(ValueError, match="other detectors"):
        Adaptive(2).load(adaptive.state())


def test_an_adaptive_subset_asks_those_more_often_that_still_see():
    ensemble, adaptive = ensemble_of(3, detectors_per_step=1)
    count = lambda: np.bincount([ensemble.asked(step)[0] for step in range(300)], minlength=3)
    assert count().min() > 70
    for _ in range(40):
        adaptive.observe({0: 0.0, 1: 0.9, 2: 0.0})
    drawn = count()
    assert drawn[1] > 150 and drawn[[0, 2]].min() > 30
    assert ensemble.weight(1, asked=1) == pytest.approx(1)
