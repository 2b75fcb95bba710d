"""What can be worn: a pattern turns places on clothes into colours. Each file of `cloak_core/patterns` has one kind."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from cloak_core.core.linear import SparseMap
from cloak_core.core.logo import Cover
from cloak_core.core.places import Places
from cloak_core.core.view import BakedView
from cloak_core.files.errors import InputError

Recolor = Callable[[Float[np.ndarray, "C 3"]], Float[np.ndarray, "C 3"]]
"""Makes other colours of some: as a printer and a camera do, say."""


class Pattern:
    """C colours, and where they lie on clothes. What is trained also has neighbours, distances and a way to be shown.

    An image is paint(view.map @ pattern.map(view.places), colours, ...), see `core/images.py`.
    """

    cover: Cover
    """The faces that wear it."""
    count: int
    """C."""
    needs_cloth: ClassVar[bool] = False
    """Whether `map` asks places where on a cloth they lie."""

    def map(self, places: Places, offset: tuple[float, float] = (0.0, 0.0)) -> SparseMap:
        """Turn places into colours: a map places x C. Rows of places that wear nothing are empty.

        offset: how far the pattern is moved, metres right and down.
        """
        raise NotImplementedError

    def colors_in(self, view: BakedView, image: int) -> Float32[Tensor, "C 3"]:
        """Give the colours that it has in one image, sRGB in [0, 1]; image: its number, for what is drawn at random."""
        raise NotImplementedError

    @property
    def layout(self) -> Hashable:
        """What decides `map`: patterns of equal layout differ in colours alone."""
        return type(self).__name__, self.cover.key

    @property
    def identity(self) -> str:
        """SHA-256 (hex) of all that decides how it looks."""
        raise NotImplementedError

    def draw_offset(self, random: np.random.Generator) -> tuple[float, float]:
        """Draw where on a body the pattern lies, for `map`; most lie in one place."""
        return 0.0, 0.0

    def recolored(self, change: Recolor) -> Pattern:
        """Wear the same in other colours."""
        raise NotImplementedError

    def on(self, cover: Cover) -> Pattern:
        """Wear the same on other faces. InputError: it has colours of faces."""
        if cover.key == self.cover.key:
            return self
        message = "these are colours of faces, which stay on theirs; a cloth or a picture covers any"
        raise InputError(f"--logo {cover.name}: {message}")

    # --- colours as they are trained

    edges: Int64[np.ndarray, "E 2"]
    """Pairs of colours that lie side by side, for total variation."""
    edge_lengths: Float[np.ndarray, " E"]
    """Metres of border between them."""
    neighbours: Int64[np.ndarray, "E 2"]
    """Pairs of values that lie side by side; the same, but where several colours share a value."""
    centres: Float[np.ndarray, "C D"]
    """Where the colours lie, metres."""
    points: Float[np.ndarray, "N D"]
    """Where the values lie."""
    value_count: int
    """N: colours that share a value are counted once."""
    spacing: float
    """Metres from a value to the next, in the median."""
    period: float | None = None
    """Metres after which values repeat; None: they do not."""

    def spread(self, values: Float[Tensor, "N 3"]) -> Float[Tensor, "C 3"]:
        """Turn values into colours, differentiably."""
        return values

    def means(self, colors: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "N 3"]:
        """Average the colours that share a value."""
        return colors

    def from_faces(self, colors: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, "C 3"]:
        """Turn colours of the worn faces into the pattern's."""
        return colors

    def on_faces(self, colors: Float[np.ndarray, "C 3"], is_exact: bool = False) -> Float[np.ndarray, "L 3"]:
        """Turn colours into those of the worn faces, for Blender and colors.npy.

        is_exact: only colours that the pattern has, no means of several.
        """
        return colors

    def picture(self, colors: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "h w 3"] | None:
        """Lay the colours out as the picture that is printed; None where it is not one piece."""
        return None


def as_tensor(colors: Float[np.ndarray, "C 3"], view: BakedView) -> Float32[Tensor, "C 3"]:
    """Copy colours to the device of a view."""
    return torch.from_numpy(np.ascontiguousarray(colors, np.float32)).to(view.pixels.device)
