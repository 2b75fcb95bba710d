"""A cloth that repeats, laid onto a logo: colours are its squares', and bodies' views are turned into views of them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int64

from cloak_core.core.cloth import Cloth, face_places
from cloak_core.core.geometry import face_areas
from cloak_core.core.logo import Logo
from cloak_core.core.view import BakedView
from cloak_core.exchange.bodies import Bodies

_POINTS = 6
"""Points of that grid along each side of a face."""


@dataclass(frozen=True, eq=False)
class ClothOnLogo:
    """A cloth, and where the faces of a logo lie on it in the first pose."""

    cloth: Cloth
    places: Float[np.ndarray, "L 2"]
    """Of the faces' centres, metres right and down."""
    widths: Float[np.ndarray, " L"]
    """Of a square as large as the face, metres."""

    @classmethod
    def of(cls, cloth: Cloth, bodies: Bodies, logo: Logo) -> ClothOnLogo:
        """Lay the cloth onto a logo."""
        return cls(cloth, face_places(bodies, logo), np.sqrt(face_areas(bodies)[logo.face_ids]))

    @property
    def count(self) -> int:
        """Number of squares, and so of colours."""
        return self.cloth.count**2

    @cached_property
    def square(self) -> Int64[np.ndarray, " L"]:
        """The square under each face's centre."""
        return self.cloth.square_at(self.places)

    def of_faces(self, values: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, "S 3"]:
        """Average values of faces in each square; squares under no face take the mean of all."""
        faces = np.bincount(self.square, minlength=self.count)
        total = np.stack([np.bincount(self.square, channel, self.count) for channel in values.T], axis=1)
        means = total / np.maximum(faces, 1)[:, None]
        return np.where(faces[:, None] > 0, means, values.mean(axis=0)).astype(np.float32)

    def on_faces(self, colors: Float[np.ndarray, "S 3"]) -> Float[np.ndarray, "L 3"]:
        """Average the squares that lie on each face, looked up at a grid of points."""
        steps = (np.arange(_POINTS) + 0.5) / _POINTS - 0.5
        total = np.zeros((len(self.places), 3))
        for step in itertools.product(steps, steps):
            total += colors[self.cloth.square_at(self.places + self.widths[:, None] * step)]
        return (total / _POINTS**2).astype(np.float32)

    def view(self, view: BakedView, random: np.random.Generator) -> BakedView:
        """Turn a view of the logo's faces into one of squares, with the cloth laid at a random place."""
        square = self.cloth.square_at(self.places + random.uniform(0, self.cloth.metres, 2))
        return replace(
            view, logo_face=torch.from_numpy(square).to(view.logo_face)[view.logo_face], logo_count=self.count
        )

    def as_logo(self, logo: Logo) -> Logo:
        """Give the logo the squares' neighbours in place of its faces', for total variation."""
        edges = self.cloth.neighbours()
        lengths = np.full(len(edges), self.cloth.metres / self.cloth.count)
        return replace(logo, edges=edges.astype(logo.edges.dtype), edge_lengths=lengths.astype(logo.edge_lengths.dtype))
