"""Cloth that repeats: what lies a tile apart is the same square."""

import numpy as np
import pytest

from cloak_core.core.cloth import Cloth, cloth_coordinates, face_places
from cloak_core.core.logo import load_logo
from cloak_core.sources.bodies.opening import load_scene


def test_panels_keep_lengths_and_are_seen_from_outside():
    points = np.array([[0.1, 1.0, 0.2], [0.1, 1.0, -0.2], [0.3, 1.0, 0.1], [-0.3, 1.0, 0.1]])
    normals = np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [-1.0, 0, 0]])
    # From the front the body's left is to the right, from behind to the left; from her left, the front is to the left.
    assert np.allclose(cloth_coordinates(points, normals), [[0.1, -1], [-0.1, -1], [-0.1, -1], [0.1, -1]])


@pytest.mark.slow
def test_faces_a_tile_apart_share_a_square():
    bodies = load_scene("sample[0:1]")
    logo = load_logo(bodies, region="shirt+trousers")
    tile, cell = 0.4, 0.05
    places = face_places(bodies, logo)
    square = Cloth.of(tile, cell).square_at(places)
    assert 40 < len(np.unique(square)) and square.max() < 64
    inside = np.floor(places / cell).astype(int) % 8
    for number in np.unique(square)[::7]:
        assert len(np.unique(inside[square == number], axis=0)) == 1


def test_a_cloth_is_interpolated_between_its_squares_and_across_its_border():
    cloth = Cloth.of(0.5, 0.26)
    assert cloth == Cloth(0.5, 2)
    shares = cloth.shares(cloth.centres() + np.array([0.5, -1.0]), np.ones(4, bool)).toarray()
    assert np.allclose(shares, np.eye(4))
    places = np.array([[0.25, 0.125], [0.3, 0.3], [0.0, 0.125], [0.125, 0.1875]])
    between = cloth.shares(places, np.array([True, False, True, True])).toarray()
    assert np.allclose(between, [[0.5, 0.5, 0, 0], [0, 0, 0, 0], [0.5, 0.5, 0, 0], [0.75, 0, 0.25, 0]])
    assert cloth.neighbours().tolist() == [[0, 1], [0, 2], [1, 3], [2, 3]]
