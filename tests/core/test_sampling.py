import numpy as np
import pytest

from cloak_core.core.cameras import Camera
from cloak_core.core.sampling import Draws, Sampler
from cloak_core.core.settings import make_settings
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.sources.bodies.source import BodyPlan, BodySource
from tests.core.fakes import box_bodies

OWN = ("background", "shift", "contrast", "brightness", "seed")


def sampler(poses=3, outfits=2, backgrounds=7, **changes) -> Sampler:
    settings = make_settings("paper", **changes)
    return Sampler(settings, BodyPlan(settings.views, poses, outfits), backgrounds)


def cameras(of: Sampler, step: int) -> list[Camera]:
    source = BodySource(box_bodies(1), RenderSettings(), of.settings.views.camera(0.0, 0.0, 1.0))
    return [source.camera(shown) for shown, _ in of.draw(step).views()]


def whole_run(of: Sampler) -> Draws:
    steps = [of.draw(step) for step in range(of.steps)]
    own = {name: np.concatenate([getattr(s, name) for s in steps]) for name in OWN}
    return Draws(**own, shown={name: np.concatenate([s.shown[name] for s in steps]) for name in steps[0].shown})


def test_an_epoch_shows_every_background_once_at_every_angle():
    of = sampler(epochs=3, batch=4, angles="-10:10:5")
    draws = whole_run(of)
    assert len(draws) == of.images == 3 * 35
    for epoch in range(3):
        part = slice(epoch * 35, (epoch + 1) * 35)
        pairs = set(zip(draws.background[part], draws.shown["azimuth"][part], strict=True))
        assert pairs == {(b, a) for b in range(7) for a in (-10.0, -5.0, 0.0, 5.0, 10.0)}
        counts = np.bincount(draws.shown["pose"][part], minlength=3)
        assert counts.max() - counts.min() <= 1
    assert not np.array_equal(draws.background[:35], draws.background[35:70]), "every epoch in an order of its own"


def test_the_last_batch_is_what_is_left():
    of = sampler(epochs=1, batch=8, angles="0")
    assert of.steps == 1 and len(of.draw(0)) == 7
    assert len(sampler(steps=3, batch=8, angles="0").draw(2)) == 8


@pytest.mark.slow
def test_draws_depend_on_seed_and_step_alone():
    one, other = sampler(steps=50, seed=5), sampler(steps=50, seed=5)
    for step in (40, 3, 41, 0):
        left, right = one.draw(step), other.draw(step)
        assert all(np.array_equal(getattr(left, name), getattr(right, name)) for name in OWN)
        assert all(np.array_equal(column, right.shown[name]) for name, column in left.shown.items())
    assert not np.array_equal(one.draw(3).shift, sampler(steps=50, seed=6).draw(3).shift)
    assert not np.array_equal(one.draw(3).shift, one.draw(4).shift)


@pytest.mark.slow
def test_ranges_are_kept_and_used():
    of = sampler(steps=200, distance="1.4:3.0", contrast="0.8:1.2", brightness="-0.1:0.1", angles="-2..2",
                 elevation_jitter=1)  # fmt: skip
    draws = whole_run(of)
    for values, low, high in (
        (draws.shown["distance"], 1.4, 3.0),
        (draws.contrast, 0.8, 1.2),
        (draws.brightness, -0.1, 0.1),
        (draws.shown["azimuth"], -2, 2),
        (draws.shift, -50, 50),
    ):
        spread = high - low
        assert low <= values.min() < low + 0.05 * spread and high - 0.05 * spread < values.max() <= high
    elevation = draws.shown["elevation"]
    assert (elevation.mean(), elevation.std()) == (pytest.approx(6, abs=0.1), pytest.approx(1, abs=0.1))
    assert set(draws.shown["outfit"]) == {0, 1}
    assert of.source.is_fresh and not sampler().source.is_fresh


def test_shares_make_up_the_batch():
    draws = sampler(steps=5).draw(2)
    shares = [draws.rank_slice(rank, 3) for rank in range(3)]
    assert sorted(np.concatenate([s.seed for s in shares])) == sorted(draws.seed)
    assert [len(s) for s in shares] == [3, 3, 2]


@pytest.mark.slow
def test_a_continuous_range_is_dealt_evenly_and_used_everywhere():
    of = sampler(steps=360, batch=10, angles="0..360", elevation="-5:20")
    draws = whole_run(of)
    assert of.source.directions == 36 and of.source.is_fresh
    counts = np.histogram(draws.shown["azimuth"], np.arange(0, 361, 10))[0]
    assert (abs(counts - 100) <= 4).all()
    assert len(set(draws.shown["azimuth"])) == 3600
    assert draws.shown["elevation"].min() < -4 and draws.shown["elevation"].max() > 19
    assert {type(camera.azimuth) for camera in cameras(of, 0)} == {float}
