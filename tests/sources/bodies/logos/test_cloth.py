"""Cloth that repeats: what lies a tile apart is the same square."""

import numpy as np

from cloak_core.exchange.cloth import cloth_coordinates
from cloak_core.patterns.cloth import Grid


def test_panels_keep_lengths_and_are_seen_from_outside():
    points = np.array([[0.1, 1.0, 0.2], [0.1, 1.0, -0.2], [0.3, 1.0, 0.1], [-0.3, 1.0, 0.1]])
    normals = np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [-1.0, 0, 0]])
    # From the front the body's left is to the right, from behind to the left; from her left, the front is to the left.
    assert np.allclose(cloth_coordinates(points, normals), [[0.1, -1], [-0.1, -1], [-0.1, -1], [0.1, -1]])


def test_squares_touch_their_neighbours_across_the_border():
    grid = Grid.of(0.5, 0.26)
    assert grid == Grid(0.5, 2, 2) and grid.neighbours().tolist() == [[0, 1], [0, 2], [1, 3], [2, 3]]
    assert grid.square_at(grid.centres() + np.array([0.5, -1.0])).tolist() == [0, 1, 2, 3]
