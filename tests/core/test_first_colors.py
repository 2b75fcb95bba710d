"""The colours that a training begins with, and the plain prints among them: without a seam."""

import numpy as np
import pytest

from cloak_core.core.logo import load_logo, make_logo
from cloak_core.core.prints import PRINT_METRES, PRINTS, print_picture
from cloak_core.core.settings import make_settings
from cloak_core.exchange.bodies import Bodies
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies.trainings.training import DARK, FUR, animal_face, first_colors
from tests.sources.bodies.solids import cube


@pytest.fixture(scope="module")
def samples() -> Bodies:
    return sample_bodies()


def test_grey_random_and_clothing(samples: Bodies) -> None:
    logo = load_logo(samples, "chest")
    begin = lambda initial, seed=0: first_colors(
        make_settings("best", initial=initial).optimization, FacePattern(logo, samples), samples, seed
    )
    assert np.array_equal(begin("clothing"), samples.face_colors[0, logo.face_ids])
    assert (begin("grey") == 0.5).all() and begin("grey").shape == (len(logo), 3)
    assert np.array_equal(begin("random", 1), begin("random", 1))
    assert not np.array_equal(begin("random", 1), begin("random", 2))


def test_a_cloth_begins_with_a_print_as_sharp_as_its_squares(samples: Bodies) -> None:
    logo = load_logo(samples, "chest")
    settings = make_settings("best", initial="ellipses").optimization
    on_faces = first_colors(settings, FacePattern(logo, samples), samples)
    dark = (on_faces == 0).all(axis=1)
    assert on_faces.shape == (len(logo), 3) and 0.2 < dark.mean() < 0.6, "the gaps between the shapes"
    # A square of 1 mm is a pixel of the print; 50 cm hold two pieces in either direction.
    piece = print_picture("ellipses")
    for pieces in (1, 2):
        cloth = ClothPattern(logo, Grid.of(0.25 * pieces, 0.001), bodies=samples)
        squares = cloth.picture(first_colors(settings, cloth, samples))
        assert np.abs(squares - np.tile(piece / 255, (pieces, pieces, 1))).max() < 0.003
    # What is no whole number of pieces wide is filled without a seam all the same.
    cloth = ClothPattern(logo, Grid.of(0.3, 0.0012), bodies=samples)
    assert np.abs(cloth.picture(first_colors(settings, cloth, samples)) - piece / 255).max() < 0.003


def test_a_small_logo_gets_a_small_animal_and_a_flat_one_none(samples: Bodies) -> None:
    chest = load_logo(samples, "chest")
    colors = animal_face(samples, chest)
    assert (colors == np.float32(DARK)).all(1).any() and (colors == np.float32(FUR)).all(1).any()
    side = make_logo(cube(), [1])
    assert (animal_face(cube(), side) == 0.5).all()
    assert np.isfinite(animal_face(cube(), make_logo(cube(), [0, 1, 4, 5]))).all()


@pytest.mark.parametrize("name", PRINTS)
def test_a_print_repeats_every_quarter_of_a_metre(name: str) -> None:
    places = np.random.default_rng(0).random((500, 2)) * PRINT_METRES
    colors = PRINTS[name].at(places)
    assert colors.dtype == np.float32 and colors.min() >= 0 and colors.max() <= 1
    for period in ((PRINT_METRES, 0), (0, PRINT_METRES), (-PRINT_METRES, 3 * PRINT_METRES)):
        moved = PRINTS[name].at(places + period)
        assert (abs(moved - colors) < 1e-3).all(axis=1).mean() > 0.99, "all but places on an edge"
