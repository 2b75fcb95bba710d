"""The data that rendering passes on: screen, visible samples, fragments, views, baked views.

A view is a linear map from places on clothes to pixels. Two sources make views: the rasterizer (a pose seen by a
camera), and photographs of people onto whose clothes faces are laid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int32, Int64
from torch import Tensor

from cloak_core.core.cameras import Number, Vector
from cloak_core.core.linear import LinearMap, SparseMap
from cloak_core.core.places import Places
from cloak_core.core.visibility.compiled import arrays
from cloak_core.core.visibility.screen import triangle_ids
from cloak_core.core.visibility.settings import Light

Cull = Bool[Tensor, " B"] | Bool[Tensor, "B T"] | None
"""Views, or triangles of each view, whose back faces are dropped; None: none."""
ViewOrBaked = TypeVar("ViewOrBaked", "View", "BakedView")
Box = tuple[Number, Number, Number, Number]
"""x0, y0, x1, y1 in pixels, x1 and y1 exclusive."""


class CrowdedPixels(UserWarning):
    """Pixels of too many pieces to resolve exactly in bounded time; they are sampled 64 x 64."""

    def __init__(self, pixels: int) -> None:
        super().__init__(f"{pixels} pixels show too many pieces to be exact: sampled 64 x 64")
        self.pixels = pixels


@dataclass(frozen=True)
class Window:
    """A part of the image, in pixels: columns x0 <= x < x1, rows y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int


@dataclass(frozen=True)
class Screen:
    """B views of V vertices: view space, and the snapped screen. All cameras of a batch share one image size."""

    width: int
    height: int
    view: Float64[Tensor, "B 3 V"]
    """View space coordinates, metres."""
    x: Int32[Tensor, "B V"]
    y: Int32[Tensor, "B V"]
    inverse_depth: Float64[Tensor, "B V"]
    """Near plane over view z: 1 at the near plane, towards 0 far away; linear on the screen along any triangle."""
    in_guard_band: Bool[Tensor, "B V"] | None
    """Vertices before the near plane and well inside the guard band (None: all). x, y and inverse_depth are undefined
    at the others; triangles with such a vertex need clipping."""
    bounds: tuple[int, int, int, int]
    """Least and greatest x, least and greatest y of all vertices; (0, 0, 0, 0) where there are none."""
    focal: Float64[Tensor, "B 1"]
    near: Float64[Tensor, "B 1"]


@dataclass(frozen=True)
class FlatTriangles:
    """N triangles of one view on the snapped screen, clipped where needed, between K corners."""

    x: Int32[Tensor, " K"]
    y: Int32[Tensor, " K"]
    inverse_depth: Float64[Tensor, " K"]
    corner: Int64[Tensor, "3 N"]
    ids: Int64[Tensor, " N"]
    one_sided: Bool[Tensor, " N"]
    """Whether the triangle is dropped where it shows its back."""

    def arrays(self) -> list[np.ndarray]:
        """Return the fields as numpy arrays, in this order."""
        return [getattr(self, column.name).contiguous().numpy() for column in fields(self)]


@dataclass(frozen=True)
class Visibility:
    """The nearest triangle at every sample of a window of B views."""

    packed: Int64[Tensor, "B rows columns"]
    """Packed depth and id (screen.py) of sample rows and columns, n to a pixel; `EMPTY` where nothing is."""
    window: Window
    width: int
    height: int
    grid: int
    """Samples along each side of a pixel, n."""

    def triangles(self) -> Int32[Tensor, "B H W S"]:
        """Unpack the triangle id per sample of the whole image, S = n * n samples of a pixel row by row; -1 = none."""
        w, n = self.window, self.grid
        ids = triangle_ids(self.packed).to(torch.int32).view(len(self.packed), w.y1 - w.y0, n, w.x1 - w.x0, n)
        image = ids.new_full((len(ids), self.height, self.width, n * n), -1)
        image[:, w.y0 : w.y1, w.x0 : w.x1] = ids.transpose(2, 3).flatten(3)
        return image


@dataclass(frozen=True)
class Fragments:
    """N fragments of a view, sorted by pixel: what is visible of one triangle within one pixel."""

    pixel: Int64[Tensor, " N"]
    """Flat, y * W + x."""
    triangle: Int64[Tensor, " N"]
    area: Float32[Tensor, " N"]
    """Share of the pixel, in (0, 1]."""
    x: Float64[Tensor, " N"]
    y: Float64[Tensor, " N"]
    """The point where the fragment is lit, pixels from the top left corner of the image: the mean of its samples, or
    its centroid."""

    @staticmethod
    def join(parts: Iterable[Fragments]) -> Fragments:
        """Concatenate fragments, from top to bottom."""
        parts = list(parts)
        if len(parts) == 1:
            return parts[0]
        whole = torch.zeros(0, dtype=torch.int64)
        none = Fragments(whole, whole, whole.float(), whole.double(), whole.double())
        parts.append(none)
        return Fragments(*(torch.cat([getattr(part, column.name) for part in parts]) for column in fields(Fragments)))


@dataclass(frozen=True, eq=False)
class Surface:
    """What decides a view's matrix besides the pose: topology, texture coordinates, light."""

    triangles: Int64[Tensor, "3 T"]
    face: Int64[Tensor, " T"]
    corner_uv: Float32[Tensor, "2 3 T"] | None
    """Texture coordinates, where the bodies have textures."""
    corner_cloth: Float32[Tensor, "2 3 T"] | None
    """Where the corners lie on a cloth, metres right and down, where views are to tell."""
    light: Light
    face_count: int
    by_face: bool
    """Whether a pixel has one entry for each face instead of each triangle. Triangles of one polygon may lie far apart
    on a texture or a cloth, so views of these have one for each triangle."""


class _Movable:
    """What is made of tensors, maps and places."""

    def to(self: ViewOrBaked, device: torch.device) -> ViewOrBaked:
        """Copy the view to a device; itself where it is there."""
        # A view that is there keeps its map, and with it the map's transpose.
        if self.pixels.to(device) is self.pixels:
            return self
        movable = {column.name: getattr(self, column.name) for column in fields(self)}
        return replace(self, **{name: value.to(device) for name, value in movable.items() if hasattr(value, "to")})


@dataclass(frozen=True, eq=False)
class View(_Movable):
    """What one image shows of faces: N covered pixels, and a sparse map of E entries, pixels x faces."""

    height: int
    width: int
    pixels: Int64[Tensor, " N"]
    """Flat index y * W + x, ascending."""
    coverage: Float32[Tensor, " N"]
    """Share of the pixel that the body covers, in (0, 1]."""
    specular: Float32[Tensor, " N"]
    """Highlight, the same in all channels."""
    map: SparseMap
    """Pixels x faces; a weight is the factor of the face's colour: its share of the pixel times its light."""
    uv: Float32[Tensor, "2 E"] | None = None
    """Where bodies have textures: texture coordinates at the centre of the visible part of the triangle in the pixel;
    there is an entry for each triangle of a face then."""
    cloth: Float32[Tensor, "4 E"] | None = None
    """Where entries lie on a cloth (`Surface.corner_cloth`): the middle of the visible part, metres right and down, and
    how wide and high it is there."""

    @staticmethod
    def join(parts: Sequence[View]) -> View:
        """Join the bands of a view, from top to bottom."""
        if len(parts) == 1:
            return parts[0]
        names = [
            name for name in ("pixels", "coverage", "specular", "uv", "cloth") if getattr(parts[0], name) is not None
        ]
        joined = {name: torch.cat([getattr(part, name) for part in parts], -1) for name in names}
        return replace(parts[0], map=SparseMap.stacked([part.map for part in parts]), **joined)

    @cached_property
    def box(self) -> tuple[int, int, int, int]:
        """(x0, y0, x1, y1) of the pixels at least half covered, x1 and y1 exclusive; zeros where there are none."""
        pixels = self.pixels[self.coverage >= 0.5].to(torch.int32)  # divided four times as fast
        if not len(pixels):
            return 0, 0, 0, 0
        low, high = torch.aminmax(pixels % self.width)
        top, left, bottom, right = torch.stack([pixels[0] // self.width, low, pixels[-1] // self.width, high]).tolist()
        return left, top, right + 1, bottom + 1


@dataclass(frozen=True, eq=False)
class Subject:
    """Whom an image shows, and whose boxes count there."""

    box: Box
    """The person's true box, which detections are compared with; before any shift of the image."""
    others: tuple[Box, ...] = ()
    """Boxes of the other people."""
    is_alone: bool = True
    """Nobody else can be in the image (a render), so that every box counts."""
    find_mask: Callable[[], Bool[Tensor, "H W"]] | None = None
    """Finds the person's pixels, where they are known better than by coverage."""


@dataclass(frozen=True, eq=False)
class BakedView(_Movable):
    """A view in which all but the colours of what is worn is a constant base image: N covered pixels.

    Pixels are ordered by what a render does with them: first the M that show places on the clothes, then, up to
    `front_count`, the others that the background shows through, then the rest.
    """

    height: int
    width: int
    pixels: Int64[Tensor, " N"]
    coverage: Float32[Tensor, " N"]
    base_color: Float32[Tensor, "3 N"]
    """What other faces, the highlight or the photograph add to each pixel; not clamped."""
    front_count: int
    map: LinearMap
    """The first M pixels x P places: each place's share of the pixel times its light."""
    places: Places
    own: Float32[Tensor, "K 3"]
    """Colours of the own clothing on the places, as `places.own` maps them; none where `base_color` shows it."""
    light_color: Vector
    """Scales the colours of what is worn."""
    subject: Subject
    stream: tuple[int, ...] | None = None
    """Seeds what a pattern draws at random in this image; None: nothing is drawn."""

    def beside(self, worn: SparseMap) -> BakedView:
        """Give the base of the image beside what is worn (places x colours): own clothing where `worn` has no entry."""
        bare = worn.crow.diff() == 0  # a place on a body wears the pattern or does not
        if worn.is_identity or not bare.any():
            return self
        shown = self.map.apply(self.seen * bare.unsqueeze(1)) * torch.tensor(self.light_color, device=bare.device)
        base = self.base_color.clone()
        base[:, : len(shown)] += shown.T
        return replace(self, base_color=base)

    @property
    def seen(self) -> Float32[Tensor, "P 3"]:
        """Colours of the own clothing at each place, before its light."""
        return self.places.own.apply(self.own)

    @property
    def mask(self) -> Bool[Tensor, "H W"]:
        """The person's pixels: those known, else those at least half covered."""
        if self.subject.find_mask is not None:
            return self.subject.find_mask()
        mask = torch.zeros(self.height * self.width, dtype=torch.bool, device=self.pixels.device)
        mask[self.pixels[self.coverage >= 0.5]] = True
        return mask.view(self.height, self.width)

    @property
    def box(self) -> Box:
        """The person's true box."""
        return self.subject.box

    @property
    def is_whole(self) -> bool:
        """Whether it fills the image, so that no background is seen."""
        return len(self.pixels) == self.height * self.width and bool((self.coverage == 1).all())

    @cached_property
    def arrays(self) -> list[np.ndarray]:
        """Pixels, coverage and base_color for loops; same memory."""
        return arrays(self.pixels, self.coverage, self.base_color)
