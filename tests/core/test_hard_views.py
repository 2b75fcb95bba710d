import numpy as np
import pytest
import torch

from cloak_core.core.sampling import EVERY, HardViews, Sampler
from cloak_core.core.settings import make_settings


def sampler(**changes) -> Sampler:
    return Sampler(make_settings("best", steps=400, angles="0..360", hard_views=0.5, **changes), 2, 1, 5)


def is_found(draws) -> np.ndarray:
    """Persons are found from behind alone."""
    return ((draws.azimuth > 120) & (draws.azimuth < 240)).astype(float)


def run(of: Sampler, steps: range) -> list:
    every = []
    for step in steps:
        draws = of.draw(step)
        of.hard_views.observe(step, draws.pose, draws.sector, is_found(draws))
        every.append(draws)
    return every


@pytest.mark.slow
def test_views_that_are_still_found_come_more_often():
    draws = run(sampler(), range(400))
    behind = [is_found(d).mean() for d in draws]
    assert np.mean(behind[:EVERY]) == pytest.approx(1 / 3, abs=0.12)
    # Half of the images evenly (a third of them from behind), half by what was found.
    assert np.mean(behind[200:]) > 0.5
    assert all((abs(d.azimuth - np.array(of)) <= 10).all() for d in draws[-5:] for of in [10 * d.sector])


def test_a_batch_built_ahead_is_the_one_that_is_asked_for():
    """What step + 1 shows is decided before step is observed."""
    of = sampler()
    for step in range(3 * EVERY):
        ahead = of.draw(step + 1)
        draws = of.draw(step)
        of.hard_views.observe(step, draws.pose, draws.sector, is_found(draws))
        assert np.array_equal(ahead.sector, of.draw(step + 1).sector)


@pytest.mark.slow
@pytest.mark.parametrize("stop", [5, EVERY - 1, EVERY, 3 * EVERY - 2, 3 * EVERY - 1, 3 * EVERY])
def test_a_resumed_sampler_draws_the_same(stop: int):
    whole = run(sampler(), range(100))
    first, second = sampler(), sampler()
    run(first, range(stop))
    second.hard_views.load({name: tensor.clone() for name, tensor in first.hard_views.state().items()})
    for expected, drawn in zip(whole[stop:], run(second, range(stop, 100)), strict=True):
        assert np.array_equal(expected.azimuth, drawn.azimuth) and np.array_equal(expected.pose, drawn.pose)


def test_the_state_of_other_views_is_refused():
    with pytest.raises(ValueError, match="other poses or angles"):
        HardViews(2, 36).load(HardViews(2, 35).state())
    with pytest.raises(KeyError):
        HardViews(2, 36).load({"parameter": torch.zeros(1)})
