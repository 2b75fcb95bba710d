"""Colours that stay close to a garment: the bounds hold exactly, whatever else is asked of the colours."""

import numpy as np
import pytest
import torch
from PIL import Image

from cloak_core.core.settings import make_settings
from cloak_core.exchange.face_lists import read_colors, write_colors
from cloak_core.files.errors import InputError
from cloak_core.patterns.choosing import pattern_of
from cloak_core.sources.bodies.logos.palette import de2000, lab
from cloak_core.techniques.near import Near, garment_colors
from tests.core.fakes import box_bodies, front_logo, techniques_of
from tests.core.test_training import run

RANDOM = np.random.default_rng(0)
PRINT = RANDOM.random((500, 3)).astype(np.float32)
COLORS = torch.from_numpy(RANDOM.random((500, 3)).astype(np.float32))


@pytest.mark.parametrize(("mean", "most"), [(5.0, 10.0), (20.0, 40.0), (20.0, 21.0), (0.5, 60.0), (60.0, 30.0)])
@pytest.mark.parametrize("garment", [PRINT, np.full((500, 3), 0.5, np.float32), np.zeros((500, 3), np.float32)])
def test_both_bounds_hold_to_the_last_bit(garment, mean, most):
    near = Near(garment, mean, most)
    found = near.project(COLORS)
    far = de2000(lab(found.numpy()), lab(garment))
    assert far.mean() <= mean and np.percentile(far, 95) <= most
    assert near.closeness(found.numpy()) == (far.mean(), np.percentile(far, 95))
    assert far.mean() > 0.97 * mean or np.percentile(far, 95) > 0.97 * most  # no closer than asked
    assert float(found.min()) >= 0 and float(found.max()) <= 1
    assert torch.equal(near.project(found), found)


def test_equal_colours_on_a_plain_garment_stay_equal():
    inks = torch.tensor([[0.1, 0.1, 0.6], [0.9, 0.9, 0.1], [0.5, 0.5, 0.5]])
    colors = inks[torch.from_numpy(RANDOM.integers(0, 3, 500))]
    found = Near(np.full((500, 3), 0.5, np.float32), 8.0, 12.0).project(colors)
    assert len(np.unique(found.numpy(), axis=0)) == 3


@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    [
        {},
        {"smooth": 4},
        {"colors_at_most": 3},
        {"pattern": "camouflage", "feature_cm": 30.0},
        {"gamut": "sigmoid"},
    ],
)
def test_a_run_ends_as_close_as_it_was_told(tmp_path, more):
    result = run(tmp_path / "run", near="#404a60", within=6, lr=0.2, steps=12, **more)
    garment = np.tile(np.float32([0x40, 0x4A, 0x60]) / 255, (len(result.colors), 1))
    far = de2000(lab(read_colors(tmp_path / "run" / "colors.npy", len(garment))), lab(garment))
    assert 1 < far.mean() <= 6 and np.percentile(far, 95) <= 12
    assert result.record()["de2000_mean"] == pytest.approx(far.mean())
    if "colors_at_most" in more:
        assert len(np.unique(result.colors, axis=0)) <= 3
    if "pattern" in more:
        free = run(tmp_path / "free", lr=0.2, steps=12, **more).colors
        assert len(np.unique(result.colors, axis=0)) <= len(np.unique(free, axis=0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "pattern", [{"pattern": "tile", "tile_cm": 50, "feature_cm": 25}, {"pattern": "camouflage", "feature_cm": 30}]
)
def test_beside_a_pattern_a_print_is_taken_in_its_mean(tmp_path, pattern):
    """So that faces which share a colour keep sharing it."""
    bodies = box_bodies()
    logo = front_logo(bodies)
    settings = make_settings(near="camouflage", within=6, **pattern)
    chosen, (near,) = pattern_of(settings.pattern, bodies, logo), techniques_of(settings, bodies=bodies)
    garment = chosen.on_faces(near.garment, is_exact=True)
    numbers = chosen.spread(torch.arange(chosen.value_count).float()[:, None].expand(-1, 3))
    patch = chosen.on_faces(numbers.numpy(), is_exact=True)[:, 0]
    printed = garment_colors("camouflage", bodies, logo)
    for number in np.unique(patch):
        assert np.allclose(garment[patch == number], printed[patch == number].mean(0), atol=1e-6)
    result = run(tmp_path / "run", near="camouflage", within=6, lr=0.2, steps=12, **pattern)
    far = de2000(lab(result.colors), lab(garment))
    assert 1 < far.mean() <= 6 and np.percentile(far, 95) <= 12
    assert all(len(np.unique(result.colors[patch == number], axis=0)) == 1 for number in np.unique(patch))


@pytest.mark.slow
def test_a_run_is_resumed_beside_the_same_garment_alone(tmp_path):
    bodies = box_bodies()
    garment = garment_colors("clothing", bodies, front_logo(bodies))
    write_colors(tmp_path / "garment.npy", garment)
    whole = run(tmp_path / "whole", near="clothing", within=5).colors
    again = run(tmp_path / "whole", near=str(tmp_path / "garment.npy"), within=5, resume=True)
    assert np.array_equal(whole, again.colors)
    with pytest.raises(InputError, match="near"):
        run(tmp_path / "whole", near="#808080", within=5, resume=True)


def test_a_picture_repeats_along_the_body(tmp_path):
    bodies = box_bodies(1)
    logo = front_logo(bodies)
    stripes = np.zeros((40, 40, 3), np.uint8)
    stripes[:, :20] = 255
    Image.fromarray(stripes).save(tmp_path / "stripes.png")
    found = garment_colors(f"{tmp_path / 'stripes.png'}@tile=0.5", bodies, logo)
    # The front's columns of quads have their middles at -0.375, -0.125, 0.125 and 0.375 m; white is 0 to 0.25. A face
    # has the mean of the print under a square of its area, which reaches over its column.
    white = found[:, 0] > 0.5
    assert white.sum() == len(logo) / 2 and set(found[white, 0]) == {0.75} and found[~white].max() <= 0.4001
    with pytest.raises(InputError, match="no width in metres"):
        garment_colors(f"{tmp_path / 'stripes.png'}@tile=wide", bodies, logo)
    with pytest.raises(InputError, match=r"none.png: no such file"):
        garment_colors(str(tmp_path / "none.png"), bodies, logo)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"near": "#808080"}, "--near GARMENT and --within DE"),
        ({"within": 5}, "--near GARMENT and --within DE"),
        ({"near": "clothing", "within": 5, "colors_at_most": 3}, "the garment must have one colour"),
        ({"near": "#808080", "within": 5, "black_box_queries": 200}, "--black-box-queries"),
        ({"near": "none.npy", "within": 5}, "none.npy"),
    ],
)
def test_what_does_not_go_together(tmp_path, changes, words):
    with pytest.raises(InputError, match=words):
        run(tmp_path / "run", **changes)
