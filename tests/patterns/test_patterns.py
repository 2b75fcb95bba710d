"""Logos cut into groups of faces of a smallest size, and the squares of cloth."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from cloak_core.core.geometry import face_areas
from cloak_core.core.logo import Logo, load_logo, make_logo
from cloak_core.exchange.cloth import cloth_coordinates
from cloak_core.patterns.cloth import Grid
from cloak_core.patterns.groups import group_of_face
from cloak_core.sources.bodies.people.samples import sample_bodies
from tests.core.fakes import box_bodies


def pieces(logo: Logo, patch: np.ndarray) -> int:
    """Groups of faces of one patch that edges join."""
    ends = logo.edges[patch[logo.edges[:, 0]] == patch[logo.edges[:, 1]]].T
    joined = csr_matrix((np.ones(ends.shape[1]), tuple(ends)), (len(logo), len(logo)))
    return connected_components(joined, directed=False)[0]


@pytest.mark.parametrize("size", [0.02, 0.05, 0.1])
def test_patches_are_joined_and_none_is_smaller_than_asked(size):
    bodies = sample_bodies("train").select_poses([0])
    logo = load_logo(bodies, region="chest+thighs")
    patch = group_of_face(bodies, logo, size)
    areas = face_areas(bodies)[logo.face_ids]
    widths = np.sqrt(np.bincount(patch, areas) * 4 / np.pi)  # of discs as large
    assert np.array_equal(np.unique(patch), np.arange(len(widths)))
    assert pieces(logo, patch) == len(widths)
    assert widths.min() >= size and np.median(widths) < 2 * size
    assert np.array_equal(patch, group_of_face(bodies, logo, size))


def test_distances_go_along_the_surface():
    """The front and the back of a thin box are near in space and far along it."""
    bodies = box_bodies()
    logo = make_logo(bodies, np.arange(bodies.face_count))
    patch = group_of_face(bodies, logo, 0.7)
    front, back = set(patch[:16]), set(patch[16:32])
    assert not front & back


def test_a_piece_that_is_too_small_stays_alone():
    bodies = box_bodies()
    logo = make_logo(bodies, np.array([0, 1, 40]))
    assert group_of_face(bodies, logo, 5.0).tolist() == [0, 0, 1]


def test_panels_keep_lengths_and_are_seen_from_outside():
    points = np.array([[0.1, 1.0, 0.2], [0.1, 1.0, -0.2], [0.3, 1.0, 0.1], [-0.3, 1.0, 0.1]])
    normals = np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [-1.0, 0, 0]])
    # From the front the body's left is to the right, from behind to the left; from her left, the front is to the left.
    assert np.allclose(cloth_coordinates(points, normals), [[0.1, -1], [-0.1, -1], [-0.1, -1], [0.1, -1]])


def test_squares_touch_their_neighbours_across_the_border():
    grid = Grid.of(0.5, 0.26)
    assert grid == Grid(0.5, 2, 2) and grid.neighbours().tolist() == [[0, 1], [0, 2], [1, 3], [2, 3]]
    assert grid.square_at(grid.centres() + np.array([0.5, -1.0])).tolist() == [0, 1, 2, 3]
