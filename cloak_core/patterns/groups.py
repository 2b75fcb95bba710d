"""Faces that share a colour in groups of a smallest size along the surface: what cloth or knitting can still show."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int64
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from torch import Tensor

from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.core.logo import Logo
from cloak_core.core.polygons import polygon_loops
from cloak_core.exchange.bodies import Bodies
from cloak_core.patterns.faces import FacePattern


@dataclass(frozen=True, eq=False)
class GroupPattern(FacePattern):
    """Colours of faces that are equal within each group of neighbouring faces."""

    group: Int64[np.ndarray, " L"] = field(kw_only=True)
    """Number of each face's group, from 0."""

    @classmethod
    def of(cls, bodies: Bodies, logo: Logo, size: float) -> GroupPattern:
        """Cut a logo into groups of at least `size` metres along the surface."""
        return cls(logo, bodies, group=group_of_face(bodies, logo, size))

    def spread(self, values: Float[Tensor, "N 3"]) -> Float[Tensor, "C 3"]:
        return values[torch.from_numpy(self.group).to(values.device)]

    def means(self, colors: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "N 3"]:
        return np.stack([np.bincount(self.group, channel) for channel in colors.T], axis=1) / self._sizes[:, None]

    def from_faces(self, colors: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, "C 3"]:
        """Give each group the mean of its faces."""
        return self.means(colors)[self.group].astype(np.float32)

    @cached_property
    def _sizes(self) -> Int64[np.ndarray, " N"]:
        return np.bincount(self.group)

    @property
    def value_count(self) -> int:
        return len(self._sizes)

    @cached_property
    def neighbours(self) -> Int64[np.ndarray, "E 2"]:
        edges = self.group[self.edges]
        return edges[edges[:, 0] != edges[:, 1]]

    @cached_property
    def points(self) -> Float[np.ndarray, "N 3"]:
        return self.means(self.centres)

    @cached_property
    def spacing(self) -> float:
        """Side of a square as large as a group, metres, in the median."""
        areas = face_areas(self.bodies)[self.cover.face_ids]
        return float(np.sqrt(np.median(np.bincount(self.group, areas))))


def group_of_face(bodies: Bodies, logo: Logo, size: float) -> Int64[np.ndarray, " L"]:
    """Cut the logo into groups of faces: the number, from 0, of each face's group; `size` in metres along the surface.

    Groups are what lies nearest to centres at least `size` apart, by the way over faces that share a corner. Each is
    joined by edges and has at least the area of a disc of that diameter, but where a whole piece of the logo has less.
    """
    ways = _ways(bodies, logo)
    centres = _spread(ways, size)
    _, _, nearest = dijkstra(ways, indices=centres, min_only=True, return_predecessors=True)
    edges = logo.edges[nearest[logo.edges[:, 0]] == nearest[logo.edges[:, 1]]]
    joined = connected_components(_matrix(edges, np.ones(len(edges)), len(logo)), directed=False)[1].astype(np.int64)
    return _merged(joined, face_areas(bodies)[logo.face_ids], logo, np.pi / 4 * size**2)


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
    is_near = np.zeros(ways.shape[0], bool)
    chosen = []
    for face in order:
        if not is_near[face]:
            chosen.append(face)
            is_near |= dijkstra(ways, indices=face, limit=size) < size
    return np.array(chosen, np.int64)


def _merged(group: np.ndarray, area: Float[np.ndarray, " L"], logo: Logo, least: float) -> Int64[np.ndarray, " L"]:
    """Join groups under `least` square metres to the neighbour with which they share the longest border."""
    areas = np.bincount(group, area)
    borders: list[dict[int, float]] = [{} for _ in areas]
    for first, second, length in zip(*group[logo.edges].T.tolist(), logo.edge_lengths.tolist(), strict=True):
        if first != second:
            borders[first][second] = borders[first].get(second, 0.0) + length
            borders[second][first] = borders[second].get(first, 0.0) + length
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
    return np.unique(into[group], return_inverse=True)[1].reshape(-1).astype(np.int64)
