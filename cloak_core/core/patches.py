"""A logo cut into patches of a smallest size along the surface: what cloth, knitting or a roller can still show."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int64
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.core.logo import Logo
from cloak_core.core.polygons import polygon_loops
from cloak_core.exchange.bodies import Bodies


def patch_of_face(bodies: Bodies, logo: Logo, size: float) -> Int64[np.ndarray, " L"]:
    """Cut the logo into patches: the number, from 0, of each face's patch; `size` in metres along the surface.

    Patches are what lies nearest to centres at least `size` apart, by the way over faces that share a corner. Each is
    joined by edges and has at least the area of a disc of that diameter, but where a whole piece of the logo has less.
    """
    ways = _ways(bodies, logo)
    centres = _spread(ways, size)
    _, _, nearest = dijkstra(ways, indices=centres, min_only=True, return_predecessors=True)
    inside = nearest[logo.edges[:, 0]] == nearest[logo.edges[:, 1]]
    return _merged(_joined(logo.edges[inside], len(logo)), face_areas(bodies)[logo.face_ids], logo, np.pi / 4 * size**2)


def _joined(edges: np.ndarray, count: int) -> Int64[np.ndarray, " L"]:
    """Number each piece that these edges join."""
    return connected_components(_matrix(edges, np.ones(len(edges)), count), directed=False)[1].astype(np.int64)


def _matrix(pairs: np.ndarray, values: np.ndarray, count: int) -> csr_matrix:
    return csr_matrix((values, (pairs[:, 0], pairs[:, 1])), (count, count))


def _ways(bodies: Bodies, logo: Logo) -> csr_matrix:
    """Measure metres between the centres of faces that share a corner: by edges alone, ways would zigzag."""
    loop_total, loop_vertices, face = polygon_loops(bodies)
    position = np.full(bodies.face_count, -1, np.int64)
    position[logo.face_ids] = np.arange(len(logo))
    owner = position[np.repeat(face, loop_total)]
    corners = csr_matrix(
        (np.ones((owner >= 0).sum()), (owner[owner >= 0], loop_vertices[owner >= 0])), (len(logo), bodies.vertex_count)
    )
    shared = (corners @ corners.T).tocoo()
    pairs = np.stack([shared.row, shared.col], axis=1)[shared.row != shared.col]
    centres = face_centres(bodies)[logo.face_ids]
    # Zero would mean "no way" in a sparse matrix.
    length = np.maximum(np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1), 1e-9)
    return _matrix(pairs, length, len(logo))


def _spread(ways: csr_matrix, size: float) -> Int64[np.ndarray, " P"]:
    """Choose faces at least `size` apart, none farther than that from the nearest; always the same ones for a logo."""
    order = np.random.default_rng(0).permutation(ways.shape[0])
    is_near, chosen = np.zeros(ways.shape[0], bool), []
    for face in order:
        if not is_near[face]:
            chosen.append(face)
            is_near |= dijkstra(ways, indices=face, limit=size) < size
    return np.array(chosen, np.int64)


def _merged(patch: np.ndarray, area: Float[np.ndarray, " L"], logo: Logo, least: float) -> Int64[np.ndarray, " L"]:
    """Join patches under `least` square metres to the neighbour with which they share the longest border."""
    areas = np.bincount(patch, area)
    borders: list[dict[int, float]] = [{} for _ in areas]
    for one, other, length in zip(*patch[logo.edges].T.tolist(), logo.edge_lengths.tolist(), strict=True):
        if one != other:
            borders[one][other] = borders[one].get(other, 0.0) + length
            borders[other][one] = borders[other].get(one, 0.0) + length
    into = np.arange(len(areas))
    for small in np.argsort(areas, kind="stable").tolist():
        if areas[small] >= least or not borders[small]:
            continue
        target = max(sorted(borders[small]), key=borders[small].get)
        into[small] = target
        areas[target] += areas[small]
        for other, length in borders[small].items():
            del borders[other][small]
            if other != target:
                borders[target][other] = borders[target].get(other, 0.0) + length
                borders[other][target] = borders[target][other]
        borders[small] = {}
        areas[small] = np.inf
    while not np.array_equal(into[into], into):
        into = into[into]
    return np.unique(into[patch], return_inverse=True)[1].reshape(-1).astype(np.int64)
