"""Cloth that repeats: what lies a tile apart is the same square."""

import numpy as np
import pytest

from cloak_core.core.logo import load_logo
from cloak_core.core.places import face_places
from cloak_core.exchange.cloth import cloth_coordinates
from cloak_core.patterns.cloth import Grid
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
    places = face_places(bodies, logo).at.T.double().numpy()
    square = Grid.of(tile, cell).square_at(places)
    assert 40 < len(np.unique(square)) and square.max() < 64
    inside = np.floor(places / cell).astype(int) % 8
    for number in np.unique(square)[::7]:
        assert len(np.unique(inside[square == number], axis=0)) == 1


def test_squares_touch_their_neighbours_across_the_border():
    grid = Grid.of(0.5, 0.26)
    assert grid == Grid(0.5, 2, 2) and grid.neighbours().tolist() == [[0, 1], [0, 2], [1, 3], [2, 3]]
    assert grid.square_at(grid.centres() + np.array([0.5, -1.0])).tolist() == [0, 1, 2, 3]
