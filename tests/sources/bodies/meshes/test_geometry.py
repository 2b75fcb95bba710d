import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cloak_core.core.geometry import (
    face_areas,
    face_centres,
    face_normals,
    inner_edges,
    outward_parts,
)
from cloak_core.core.polygons import MAX_CORNERS, triangulate
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.people.samples import sample_bodies
from tests.sources.bodies.solids import cube, polygons


def test_areas_normals_and_centres_of_a_cube() -> None:
    body = cube()
    assert np.allclose(face_areas(body), 1)
    outwards = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])
    assert np.allclose(face_normals(body), outwards)
    assert np.allclose(face_centres(body), 0.5 + outwards / 2)


def test_inner_edges_against_brute_force() -> None:
    body = sample_bodies("unseen")
    ids = np.flatnonzero(body.regions["hands"])
    pairs, lengths = inner_edges(body, ids)
    quads = body.loop_vertices.reshape(-1, 4)[ids]
    owners: dict[frozenset, list[int]] = {}
    for face, quad in enumerate(quads.tolist()):
        for a, b in zip(quad, quad[1:] + quad[:1], strict=True):
            owners.setdefault(frozenset((a, b)), []).append(face)
    expected = {(*two, edge) for edge, two in owners.items() if len(two) == 2}
    assert len(pairs) == len(expected)
    assert {tuple(pair) for pair in pairs.tolist()} == {(a, b) for a, b, _ in expected}
    total = sum(np.linalg.norm(np.subtract(*body.vertices[0][list(edge)].astype(float))) for *_, edge in expected)
    assert lengths.sum() == pytest.approx(total)


def test_an_edge_of_three_faces_joins_each_two() -> None:
    fins = polygons(
        np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1]]), [[0, 1, 2], [0, 1, 3], [0, 1, 4]]
    )
    pairs, _ = inner_edges(fins, np.arange(3))
    assert sorted(map(tuple, pairs.tolist())) == [(0, 1), (0, 2), (1, 2)]


def test_each_part_drops_its_own_backs() -> None:
    """A cube, one inside out, one with a hole, and a needle."""
    body, count = cube(), len(cube().triangles)
    shift = lambda n: body.vertices + 10 * n
    needle = np.array([[24, 24, 25]], body.triangles.dtype)
    triangles = [body.triangles, body.triangles[:, ::-1] + 8, body.triangles[1:] + 16, needle]
    parts = Bodies(np.concatenate([shift(0), shift(1), shift(2), shift(3)[:, :2]], 1), np.concatenate(triangles))
    assert outward_parts(parts)[0].nonzero()[0].tolist() == list(range(count))
    assert outward_parts(parts.select_poses([0, 0])).sum() == 2 * count


def split(points: list, faces: list[list[int]]) -> tuple[np.ndarray, np.ndarray]:
    total = np.array([len(face) for face in faces], np.int32)
    loop = np.concatenate(faces).astype(np.int32)
    corners, face = triangulate(np.asarray(points, np.float32), total, loop)
    return loop[corners], face


def test_triangles_of_a_polygon_stay_together_and_know_it() -> None:
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [3, 0.5, 0]]
    triangles, face = split(points, [[0, 1, 2, 3], [1, 4, 2], [1, 4, 6, 5, 2]])
    assert face.tolist() == [0, 0, 1, 2, 2, 2]
    assert set(triangles[3:].ravel()) == {1, 4, 6, 5, 2}


@pytest.mark.parametrize("turn", range(4))
def test_a_concave_quad_takes_the_diagonal_inside_it(turn: int) -> None:
    arrow = [[0, 0, 0], [2, -2, 0], [0, 4, 0], [-2, -2, 0]]  # the notch is corner 0
    loop = [(i + turn) % 4 for i in range(4)]
    triangles, _ = split(arrow, [loop])
    assert all({0, 2} <= set(triangle) for triangle in triangles.tolist())


@pytest.mark.slow
@given(
    radii=st.lists(st.floats(0.05, 1.0), min_size=5, max_size=24),
    tilt=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.05, 1)),
    seed=st.integers(0, 1 << 16),
)
@settings(max_examples=150)
def test_concave_polygons_are_tiled_exactly(radii: list[float], tilt: tuple, seed: int) -> None:
    """Star-shaped polygons in any plane: triangles turn the polygon's way, and their areas add up to its area."""
    count = len(radii)
    angle = 2 * np.pi * np.arange(count) / count
    flat = np.array(radii)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    normal = np.array(tilt) / np.linalg.norm(tilt)
    u = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    u /= np.linalg.norm(u)
    points = flat @ np.stack([u, np.cross(normal, u)])
    order = np.random.default_rng(seed).permutation(count)  # vertex numbers say nothing about the loop
    scattered = np.empty_like(points)
    scattered[order] = points
    triangles, face = split(scattered, [order.tolist()])
    a, b, c = scattered[triangles].transpose(1, 0, 2)
    areas = np.cross(b - a, c - a) @ normal / 2
    following = np.roll(flat, -1, axis=0)
    area = (flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]).sum() / 2
    assert len(triangles) == count - 2 and (face == 0).all()
    assert areas.min() > -1e-6
    assert areas.sum() == pytest.approx(area, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("points", [np.zeros((7, 3)), np.arange(21.0).reshape(7, 3), np.eye(3)[[0, 1, 0, 1, 2, 2, 0]]])
def test_degenerate_polygons_still_give_their_number_of_triangles(points: np.ndarray) -> None:
    triangles, _ = split(points, [list(range(7))])
    assert triangles.shape == (5, 3)
    assert (np.sort(triangles, axis=1)[:, 1:] != np.sort(triangles, axis=1)[:, :-1]).all()


def test_absurd_polygons_are_refused() -> None:
    with pytest.raises(InputError, match="corners"):
        split(np.zeros((MAX_CORNERS + 1, 3)), [list(range(MAX_CORNERS + 1))])
