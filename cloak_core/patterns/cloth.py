"""A cloth that repeats: a picture of squares, trained or any other, as finely as an image can show it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64, UInt8

from cloak_core.core.linear import SparseMap
from cloak_core.core.logo import Cover
from cloak_core.core.places import Places, face_places
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.identity import sha256_arrays, sha256_record
from cloak_core.patterns.faces import Colored
from cloak_core.patterns.footprint import squares_under


@dataclass(frozen=True)
class Grid:
    """Squares of a cloth: `rows` rows of `columns`, `metres` wide, numbered row by row from the top left."""

    metres: float
    columns: int
    rows: int

    @classmethod
    def of(cls, metres: float, square: float) -> Grid:
        """Divide a square cloth into squares of this width in metres, rounded so that a whole number fits."""
        columns = max(1, round(metres / square))
        return cls(metres, columns, columns)

    @property
    def square(self) -> float:
        """Width and height of a square, metres."""
        return self.metres / self.columns

    def __len__(self) -> int:
        """Count the squares."""
        return self.rows * self.columns

    def square_at(self, places: Float[np.ndarray, "N 2"]) -> Int64[np.ndarray, " N"]:
        """Find the square under each place on the cloth, metres right and down."""
        column, row = np.floor(places / self.metres * self.columns).astype(np.int64).T
        return row % self.rows * self.columns + column % self.columns

    def neighbours(self) -> Int64[np.ndarray, "E 2"]:
        """List the pairs of squares that share a side, across the border where the cloth repeats, too."""
        number = np.arange(len(self)).reshape(self.rows, self.columns)
        pairs = [np.stack([number, np.roll(number, -1, axis)], axis=-1).reshape(-1, 2) for axis in (0, 1)]
        edges = np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)
        return edges[edges[:, 0] != edges[:, 1]]

    def centres(self) -> Float[np.ndarray, "S 2"]:
        """Find the middles of the squares, metres right and down."""
        row, column = np.divmod(np.arange(len(self)), self.columns)
        return (np.stack([column, row], axis=1) + 0.5) * self.square


@dataclass(frozen=True, eq=False)
class ClothPattern(Colored):
    """The squares of a cloth that is cut into clothes. It may lie anywhere on a body: nobody cuts it in one place."""

    cover: Cover
    grid: Grid
    colors: Float32[np.ndarray, "S 3"] | None = None
    bodies: Bodies | None = None
    """Whose faces `on_faces` shows it on."""
    needs_cloth = True

    @classmethod
    def of_picture(
        cls, cover: Cover, picture: UInt8[np.ndarray, "h w 3"], metres: float, **more: object
    ) -> ClothPattern:
        """Wear a picture `metres` wide: a square for each of its pixels."""
        height, width = picture.shape[:2]
        return cls(cover, Grid(metres, width, height), picture.reshape(-1, 3).astype(np.float32) / 255, **more)

    @property
    def count(self) -> int:
        return len(self.grid)

    def map(self, places: Places, offset: tuple[float, float] = (0.0, 0.0)) -> SparseMap:
        """See `Pattern`: the mean of the squares under each place."""
        moved = places.at + torch.tensor(offset, dtype=torch.float32, device=places.at.device).unsqueeze(1)
        grid = self.grid
        return squares_under(moved, places.extent, places.face >= 0, grid.square, grid.rows, grid.columns)

    def draw_offset(self, random: np.random.Generator) -> tuple[float, float]:
        return tuple(random.uniform(0, self.grid.metres, 2).tolist())

    @property
    def layout(self) -> tuple[str, Grid, str]:
        return type(self).__name__, self.grid, self.cover.key

    @property
    def identity(self) -> str:
        grid = [self.grid.metres, self.grid.columns, self.grid.rows]
        return sha256_record([type(self).__name__, self.cover.key, grid, sha256_arrays(self.colors)])

    def on(self, cover: Cover) -> ClothPattern:
        return replace(self, cover=cover)

    @cached_property
    def edges(self) -> Int64[np.ndarray, "E 2"]:
        return self.grid.neighbours()

    @property
    def edge_lengths(self) -> Float[np.ndarray, " E"]:
        return np.full(len(self.edges), self.grid.square)

    @cached_property
    def centres(self) -> Float[np.ndarray, "S 2"]:
        """Middles of the squares, metres right and down."""
        return self.grid.centres()

    @property
    def spacing(self) -> float:
        return self.grid.square

    @property
    def period(self) -> float:
        return self.grid.metres

    @cached_property
    def _faces(self) -> Places:
        return face_places(self.bodies, self.cover)

    @cached_property
    def _under_faces(self) -> Int64[np.ndarray, " L"]:
        """The square under each face's centre."""
        return self.grid.square_at(self._faces.at.T.double().numpy())

    def from_faces(self, colors: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, "S 3"]:
        """See `Pattern`: each square gets the mean of the faces above it; squares under no face that of all."""
        square = self._under_faces
        faces = np.bincount(square, minlength=self.count)
        total = np.stack([np.bincount(square, channel, self.count) for channel in colors.T], axis=1)
        means = total / np.maximum(faces, 1)[:, None]
        return np.where(faces[:, None] > 0, means, colors.mean(axis=0)).astype(np.float32)

    def on_faces(self, colors: Float[np.ndarray, "S 3"], is_exact: bool = False) -> Float[np.ndarray, "L 3"]:
        """See `Pattern`: the mean of the squares on each face, or the square under its centre."""
        if is_exact:
            return colors[self._under_faces]
        return self.map(self._faces).apply(torch.from_numpy(np.ascontiguousarray(colors, np.float32))).numpy()

    def picture(self, colors: Float[np.ndarray, "S 3"]) -> Float[np.ndarray, "h w 3"]:
        return colors.reshape(self.grid.rows, self.grid.columns, 3)
