import numpy as np
import pytest

from cloak_core.core.geometry import (
    face_areas,
    face_centres,
    face_normals,
    inner_edges,
    outward_parts,
)
from cloak_core.exchange.bodies import Bodies
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
