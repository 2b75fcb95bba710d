"""Cloth on a body: where each point of the surface lies on a flat piece of cloth that repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64
from scipy import sparse

from cloak_core.core.geometry import face_centres, face_normals
from cloak_core.core.logo import Logo
from cloak_core.exchange.bodies import Bodies

CLOTH_FILE = "cloth.png"
"""Of a run: what to print, a pixel for each square."""


def cloth_coordinates(points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 2"]:
    """Map points to metres right and down on the cloth, as seen from outside.

    Clothes are cut from flat panels: front and back are projected along z, the sides along x.
    """
    sideways = np.abs(normals[:, 0]) > np.abs(normals[:, 2])
    across = np.where(normals[:, 2] < 0, -points[:, 0], points[:, 0])
    across = np.where(sideways, -points[:, 2] * np.sign(normals[:, 0]), across)
    return np.stack([across, -points[:, 1]], axis=1)


def face_places(bodies: Bodies, logo: Logo) -> Float[np.ndarray, "L 2"]:
    """Cloth coordinates of the centres of the logo's faces in the first pose, metres."""
    return cloth_coordinates(face_centres(bodies)[logo.face_ids], face_normals(bodies)[logo.face_ids])


@dataclass(frozen=True)
class Cloth:
    """A picture of count x count squares that repeats every `metres` in both directions.

    Squares are numbered row by row from the top left.
    """

    metres: float
    count: int

    @classmethod
    def of(cls, metres: float, square: float) -> Cloth:
        """Make a cloth of squares of this width in metres, rounded so that a whole number fits."""
        return cls(metres, max(1, round(metres / square)))

    def square_at(self, places: Float[np.ndarray, "N 2"]) -> Int64[np.ndarray, " N"]:
        """Find the square under each place on the cloth, metres right and down."""
        column, row = (np.floor(places / self.metres * self.count).astype(np.int64) % self.count).T
        return row * self.count + column

    def shares(self, places: Float[np.ndarray, "N 2"], shown: Bool[np.ndarray, " N"]) -> sparse.csr_matrix:
        """Interpolate bilinearly between squares: weights [N, squares] that add up to 1 where the cloth is shown."""
        at = places[shown] / self.metres * self.count - 0.5
        first = np.floor(at).astype(np.int64)
        right, down = (at - first).T
        columns, weights = [], []
        for x, across in ((0, 1 - right), (1, right)):
            for y, along in ((0, 1 - down), (1, down)):
                columns.append((first[:, 1] + y) % self.count * self.count + (first[:, 0] + x) % self.count)
                weights.append(across * along)
        rows = np.concatenate([[0], np.cumsum(4 * shown)])
        entries = (np.stack(weights, axis=1).ravel(), np.stack(columns, axis=1).ravel(), rows)
        return sparse.csr_matrix(entries, shape=(len(places), self.count**2))

    def neighbours(self) -> Int64[np.ndarray, "E 2"]:
        """List the pairs of squares that share a side, across the border where the cloth repeats, too."""
        number = np.arange(self.count**2).reshape(self.count, self.count)
        pairs = [np.stack([number, np.roll(number, -1, axis)], axis=-1).reshape(-1, 2) for axis in (0, 1)]
        edges = np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)
        return edges[edges[:, 0] != edges[:, 1]]

    def centres(self) -> Float[np.ndarray, "S 2"]:
        """Middles of the squares, metres right and down."""
        row, column = np.divmod(np.arange(self.count**2), self.count)
        return (np.stack([column, row], axis=1) + 0.5) * self.metres / self.count
