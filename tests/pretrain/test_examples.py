"""The examples the built-in detector learns from: boxes that fit the people, outfits that colour the body, places."""

import numpy as np
import pytest
import torch

from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from tools.pretrain.examples import ExampleMaker
from tools.pretrain.outfits import Wardrobe
from tools.pretrain.people import FRAME, render_people
from tools.pretrain.scenery import Scenery

SIZE = 96


@pytest.fixture(scope="module")
def bodies():
    return sample_bodies("train")


@pytest.fixture(scope="module")
def maker(bodies):
    views = render_people(bodies, 8, np.random.default_rng(0))
    return ExampleMaker(views, Wardrobe(bodies), Scenery(load_backgrounds("procedural:train:3")), SIZE)


def test_a_cropped_view_is_the_renderers_view(bodies, maker):
    """Dressed in one of the scene's own outfits, coverage is at most 1 and colours stay below it."""
    for view in maker.views:
        patch = view.dress(torch.from_numpy(bodies.face_colors[0]))
        assert patch.shape == (4, view.height, view.width)
        assert patch[3].max() <= 1.001 and patch[:3].max() <= 1.001 and patch.min() >= 0
        assert patch[3].sum() > 100 and (patch[3].amax(0) > 0).all() and (patch[3].amax(1) > 0).all(), "cropped tightly"
        assert abs(view.origin[0] + view.width / 2) < FRAME / 4, "people stand in the middle of the picture"


def test_boxes_fit_the_people_that_are_painted(maker, monkeypatch):
    """Over a white place everything darker is the person, and the box must lie around just that."""
    monkeypatch.setattr(maker.scenery, "draw", lambda rng, size: np.full((size, size, 3), 255, np.uint8))
    checked = 0
    for seed in range(8):
        example = maker.example(np.random.default_rng(seed), 1, plain=True)
        if example.present[0]:
            changed = (example.image < 0.98).any(0)
            rows, columns = changed.any(1).nonzero()[:, 0], changed.any(0).nonzero()[:, 0]
            painted = torch.stack([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1]) / SIZE
            assert (painted - example.boxes[0]).abs().max() <= 4 / SIZE
            checked += 1
    assert checked >= 4


def test_batches_hold_what_they_say(maker):
    hard = [maker.place(np.random.default_rng(5))] * 2
    batch = maker.batch(np.random.default_rng(2), 12, hard)
    assert batch.images.shape == (12, 3, SIZE, SIZE) and 0 <= batch.images.min() and batch.images.max() <= 1
    assert not batch.present[-2:].any() and batch.present[:-2].any()
    assert not (batch.present & batch.ignored).any()
    real = batch.boxes[batch.present]
    assert (real[:, 2:] > real[:, :2]).all() and real.min() >= 0 and real.max() <= 1
    again = maker.batch(np.random.default_rng(2), 12, hard)
    assert all(torch.equal(a, b) for a, b in zip(batch, again, strict=True)), "the same seed, the same batch"
