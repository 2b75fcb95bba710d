"""Controls: what is worn beside the judged pattern, on the same faces."""

import numpy as np
import pytest
import torch

from cloak_core.core.cameras import Camera
from cloak_core.core.geometry import face_centres
from cloak_core.core.images import dressed
from cloak_core.core.logo import Cover
from cloak_core.core.paint import blank
from cloak_core.core.pattern import Pattern
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.patterns.controls import STRIPE, controls
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.bodies.source import BodySource
from tests.sources.bodies.solids import sheet

WALL = sheet(20, 0.4, face_colors=np.random.default_rng(0).random((2, 400, 3)))
"""20 x 20 quads of 2 cm, upright; two outfits."""
TRAINED = np.random.default_rng(1).random((400, 3)).astype(np.float32)
SHOWN = {"pose": 0, "outfit": 1, "azimuth": 0.0, "elevation": 0.0, "distance": 0.5}


def worn(*names: str, seed: int = 0, faces: np.ndarray | None = None) -> list[Pattern]:
    faces = np.arange(400) if faces is None else faces
    judged = FacePattern(Cover(faces, WALL.topology), colors=TRAINED[faces])
    return list(controls(names, judged, seed, WALL).values())


def view_of(pattern: Pattern, on_cloth: bool = False) -> BakedView:
    source = BodySource(WALL, RenderSettings(samples=1), Camera(width=64, height=64), on_cloth=on_cloth)
    return source.view(SHOWN, None, pattern)


def painted(view: BakedView, pattern: Pattern) -> torch.Tensor:
    return dressed([view], pattern, blank(1, 64, 64).zero_()).paint(pattern.colors_in(view, 0))[0].clone()


def test_clothing_is_each_outfits_own_and_grey_is_grey() -> None:
    some = np.array([3, 7])
    clothing, grey = worn("clothing", "grey", faces=some)
    assert np.array_equal(clothing.colors_in(view_of(clothing), 0), WALL.face_colors[1, some])
    assert np.array_equal(grey.colors, np.full((2, 3), 0.5))


@pytest.mark.parametrize("on_cloth", [False, True])
def test_own_clothing_is_the_body_as_it_is_and_comes_back_from_the_faces_of_a_render(on_cloth: bool) -> None:
    whole, resampled = worn("clothing", "resampled")
    (one,) = worn("clothing", faces=np.array([0]))
    images = [painted(view_of(pattern, on_cloth), pattern) for pattern in (whole, one, resampled)]
    for image in images[1:]:
        torch.testing.assert_close(image, images[0], rtol=0, atol=1e-5)
    assert images[0].std() > 0.1


@pytest.mark.parametrize("control", ["stripes", "checks"])
def test_natural_patterns_are_as_strong_as_the_trained_one(control: str) -> None:
    (pattern,) = worn(control)
    luminance = lambda c: (c @ np.array([0.2126, 0.7152, 0.0722])).std()
    assert luminance(pattern.colors) == pytest.approx(luminance(TRAINED), rel=0.05)
    assert len(np.unique(pattern.colors, axis=0)) == 2


def test_stripes_run_around_and_checks_alternate() -> None:
    center = face_centres(WALL)
    row, column = np.floor(center[:, 1] / STRIPE), np.floor(center[:, 0] / STRIPE)
    stripes, checks = (pattern.colors[:, 0] for pattern in worn("stripes", "checks"))
    assert all(len(np.unique(stripes[row == r])) == 1 for r in np.unique(row))
    assert np.array_equal(stripes > 0.5, row % 2 == 0)
    assert np.array_equal(checks > 0.5, (row + column) % 2 == 0)


def test_random_colors_depend_on_seed_and_image_alone() -> None:
    (pattern,), (other,) = worn("random"), worn("random", seed=1)
    view = view_of(pattern)
    drawn = lambda pattern, image: pattern.colors_in(view, image)
    assert torch.equal(drawn(pattern, 5), drawn(pattern, 5))
    assert not torch.equal(drawn(pattern, 5), drawn(pattern, 6))
    assert not torch.equal(drawn(pattern, 5), drawn(other, 5)) and pattern.identity != other.identity
