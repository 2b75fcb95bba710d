"""Colours of faces: each face that is worn has one of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.core.linear import SparseMap
from cloak_core.core.logo import Cover, Logo
from cloak_core.core.pattern import Pattern, Recolor, as_tensor
from cloak_core.core.places import Places
from cloak_core.core.view import BakedView
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays, sha256_record


class Colored(Pattern):
    """What patterns with a colour of their own for each face or square have in common."""

    colors: Float32[np.ndarray, "C 3"] | None
    """The colours that are judged; None: it is to be trained."""

    def colors_in(self, view: BakedView, image: int) -> Float32[Tensor, "C 3"]:
        return as_tensor(self.colors, view)

    def recolored(self, change: Recolor) -> Pattern:
        return replace(self, colors=np.asarray(change(self.colors), np.float32))

    @property
    def neighbours(self) -> Int64[np.ndarray, "E 2"]:
        return self.edges

    @property
    def points(self) -> Float[np.ndarray, "C D"]:
        return self.centres

    @property
    def value_count(self) -> int:
        return self.count


@dataclass(frozen=True, eq=False)
class FacePattern(Colored):
    """The faces of a logo. What is only judged needs neither bodies nor a logo's edges.

    InputError: another number of colours than of faces.
    """

    cover: Cover | Logo
    bodies: Bodies | None = None
    colors: Float32[np.ndarray, "L 3"] | None = None

    def __post_init__(self) -> None:
        if self.colors is not None and len(self.colors) != len(self.cover):
            raise InputError(f"colours for {len(self.colors)} faces, but the logo has {len(self.cover)}")

    @property
    def count(self) -> int:
        return len(self.cover)

    def map(self, places: Places, offset: tuple[float, float] = (0.0, 0.0)) -> SparseMap:
        return places.shares

    @property
    def layout(self) -> tuple[str, str]:
        return "faces", self.cover.key  # whatever colours faces is laid alike

    @property
    def identity(self) -> str:
        colors = None if self.colors is None else sha256_arrays(self.colors)
        return sha256_record([type(self).__name__, self.cover.key, colors])

    @property
    def edges(self) -> Int64[np.ndarray, "E 2"]:
        return self.cover.edges

    @property
    def edge_lengths(self) -> Float[np.ndarray, " E"]:
        return self.cover.edge_lengths

    @cached_property
    def centres(self) -> Float[np.ndarray, "L 3"]:
        """Middles of the faces, metres, in the first pose."""
        return face_centres(self.bodies)[self.cover.face_ids]

    @cached_property
    def spacing(self) -> float:
        """Side of a square as large as a face, metres, in the median."""
        return float(np.sqrt(np.median(face_areas(self.bodies)[self.cover.face_ids])))
