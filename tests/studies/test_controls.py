"""Controls: what they colour the logo's faces with."""

import numpy as np
import pytest

from cloak_core.core.evaluation.controls import STRIPE, control_colors, random_colors
from cloak_core.core.geometry import face_centres
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError


def wall() -> Bodies:
    """20 x 20 quads of 2 cm, upright, each split in two triangles; two outfits."""
    grid = np.arange(21) * 0.02
    x, y = np.meshgrid(grid, grid, indexing="xy")
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)[None].astype(np.float32)
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    quads = np.stack([corner, corner + 1, corner + 22, corner + 21], 1)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    faces = np.tile(np.arange(400, dtype=np.int32), 2)
    outfits = np.random.default_rng(0).random((2, 400, 3)).astype(np.float32)
    return Bodies(vertices=vertices, triangles=triangles, triangle_face=faces, face_colors=outfits)


TRAINED = np.random.default_rng(1).random((400, 3)).astype(np.float32)
ALL = np.arange(400)


def test_clothing_is_each_outfits_own_and_grey_is_grey() -> None:
    bodies, some = wall(), np.array([3, 7])
    assert np.array_equal(control_colors("clothing", TRAINED[:2], bodies, some), bodies.face_colors[:, some])
    assert np.array_equal(control_colors("grey", TRAINED[:2], bodies, some), np.full((2, 2, 3), 0.5))
    assert np.array_equal(control_colors("logo", TRAINED[:2], bodies, some), np.stack([TRAINED[:2]] * 2))


@pytest.mark.parametrize("control", ["stripes", "checks"])
def test_natural_patterns_are_as_strong_as_the_trained_one(control: str) -> None:
    colors = control_colors(control, TRAINED, wall(), ALL)[0]
    luminance = lambda c: (c @ np.array([0.2126, 0.7152, 0.0722])).std()
    assert luminance(colors) == pytest.approx(luminance(TRAINED), rel=0.05)
    assert len(np.unique(colors, axis=0)) == 2


def test_stripes_run_around_and_checks_alternate() -> None:
    bodies = wall()
    center = face_centres(bodies)
    row, column = np.floor(center[:, 1] / STRIPE), np.floor(center[:, 0] / STRIPE)
    stripes = control_colors("stripes", TRAINED, bodies, ALL)[0, :, 0]
    assert all(len(np.unique(stripes[row == r])) == 1 for r in np.unique(row))
    assert np.array_equal(stripes > 0.5, row % 2 == 0)
    checks = control_colors("checks", TRAINED, bodies, ALL)[0, :, 0]
    assert np.array_equal(checks > 0.5, (row + column) % 2 == 0)


def test_random_colors_depend_on_seed_and_image_alone() -> None:
    assert np.array_equal(random_colors(0, 5, 9), random_colors(0, 5, 9))
    assert not np.array_equal(random_colors(0, 5, 9), random_colors(0, 6, 9))
    assert not np.array_equal(random_colors(0, 5, 9), random_colors(1, 5, 9))


def test_unknown_control() -> None:
    with pytest.raises(InputError, match="'plaid'"):
        control_colors("plaid", TRAINED, wall(), ALL)
