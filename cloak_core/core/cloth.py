"""Cloth on a body: where each point of the surface lies on a flat piece of cloth that repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64
from scipy import sparse

from cloak_core.core.geometry import face_centres, face_normals
from cloak_core.core.logo import Logo
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.cloth import cloth_coordinates as cloth_coordinates

MOST_SQUARES = 8
"""Squares along each side of what is seen at once that are averaged; of more, as many evenly spaced ones do."""
LEAST_SQUARES = 1e-3
"""Least width of what is seen at once, squares: below it, rounding decides."""


def face_places(bodies: Bodies, logo: Logo) -> Float[np.ndarray, "L 2"]:
    """Cloth coordinates of the centres of the logo's faces in the pose for cloth, metres."""
    bodies = bodies.for_cloth()
    return cloth_coordinates(face_centres(bodies)[logo.face_ids], face_normals(bodies)[logo.face_ids])


def corner_places(bodies: Bodies) -> Float[np.ndarray, "2 3 T"]:
    """Cloth coordinates of the triangles' corners, metres, as `face_places`; a face's triangles lie in one panel."""
    bodies = bodies.for_cloth()
    points = bodies.vertices[0][bodies.triangles]  # [T, 3, 3]
    normals = face_normals(bodies)[bodies.triangle_face]
    corners = [cloth_coordinates(points[:, corner], normals) for corner in range(3)]
    return np.stack(corners).transpose(2, 0, 1)


@dataclass(frozen=True)
class Cloth:
    """A picture of squares that repeats in both directions: of `rows` rows of `count`, `metres` wide.

    Squares are numbered row by row from the top left.
    """

    metres: float
    count: int
    rows: int

    @classmethod
    def of(cls, metres: float, square: float) -> Cloth:
        """Make a cloth of squares of this width in metres, rounded so that a whole number fits."""
        count = max(1, round(metres / square))
        return cls(metres, count, count)

    @property
    def square(self) -> float:
        """Width and height of a square, metres."""
        return self.metres / self.count

    def __len__(self) -> int:
        """Count the squares."""
        return self.rows * self.count

    def square_at(self, places: Float[np.ndarray, "N 2"]) -> Int64[np.ndarray, " N"]:
        """Find the square under each place on the cloth, metres right and down."""
        column, row = np.floor(places / self.metres * self.count).astype(np.int64).T
        return row % self.rows * self.count + column % self.count

    def shares(self, places: Float[np.ndarray, "N 2"], shown: Bool[np.ndarray, " N"]) -> sparse.csr_matrix:
        """Interpolate bilinearly between squares: weights [N, squares] that add up to 1 where the cloth is shown."""
        at = places[shown] / self.metres * self.count - 0.5
        first = np.floor(at).astype(np.int64)
        right, down = (at - first).T
        columns, weights = [], []
        for x, across in ((0, 1 - right), (1, right)):
            for y, along in ((0, 1 - down), (1, down)):
                columns.append((first[:, 1] + y) % self.rows * self.count + (first[:, 0] + x) % self.count)
                weights.append(across * along)
        rows = np.concatenate([[0], np.cumsum(4 * shown)])
        entries = (np.stack(weights, axis=1).ravel(), np.stack(columns, axis=1).ravel(), rows)
        return sparse.csr_matrix(entries, shape=(len(places), len(self)))

    def neighbours(self) -> Int64[np.ndarray, "E 2"]:
        """List the pairs of squares that share a side, across the border where the cloth repeats, too."""
        number = np.arange(len(self)).reshape(self.rows, self.count)
        pairs = [np.stack([number, np.roll(number, -1, axis)], axis=-1).reshape(-1, 2) for axis in (0, 1)]
        edges = np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)
        return edges[edges[:, 0] != edges[:, 1]]

    def centres(self) -> Float[np.ndarray, "S 2"]:
        """Middles of the squares, metres right and down."""
        row, column = np.divmod(np.arange(len(self)), self.count)
        return (np.stack([column, row], axis=1) + 0.5) * self.metres / self.count
