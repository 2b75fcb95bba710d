"""A pattern as a picture on a layout, and the whole body's texture coordinates into it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Integer, UInt8

from cloak_core.core.pattern import Pattern
from cloak_core.core.places import Places, corner_places
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.products.layout import Layout, signed_areas
from cloak_core.sources.bodies.meshes.textures import color_squares, to_bytes

MAX_PIXELS = 400 << 20
PADDING = 0.002
"""Metres that a chart's colours reach beyond its border, so that no seam shows when the picture is sampled smoothly."""


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture for the whole body: the logo's charts, below them one cell for every other colour."""

    image: np.ndarray
    """[H, W, 3] uint8, row 0 at the top."""
    uv: np.ndarray
    """[T, 3, 2] float64: texture coordinates of every triangle's corners, v up."""
    chart_rows: int
    """Rows of the picture, from the top, that show the charts."""


MOST_TEXELS = 1 << 21
"""Points of a picture that are looked up on a pattern at once."""


def bake(bodies: Bodies, layout: Layout, pattern: Pattern, dpi: int) -> Texture:
    """Paint a pattern in its colours, and the first outfit's on all other faces, at `dpi` dots to the inch.

    layout: of the faces that the pattern covers.
    """
    dots = dpi / 0.0254
    width, rows = (int(np.ceil(extent * dots)) for extent in layout.size)
    plain = np.setdiff1d(np.arange(bodies.triangle_count), layout.triangles)
    squares, centres = color_squares(bodies.face_colors[0][bodies.triangle_face[plain]], width)
    height = rows + len(squares)
    if width * height > MAX_PIXELS:
        raise InputError(f"{dpi} dpi: a picture of {width} x {height} pixels is too large")
    image = np.full((height, width, 3), 255, np.uint8)
    painted = paint(image[:rows], layout, pattern, bodies, dots)
    spread(image[:rows], painted, int(np.ceil(PADDING * dots)))
    image[rows:] = squares
    uv = np.zeros((bodies.triangle_count, 3, 2))
    uv[layout.triangles] = (layout.corners * dots + [0, height - rows]) / [width, height]
    uv[plain] = ((centres + np.array([0, rows])) / [width, height] * [1, -1] + [0, 1])[:, None]
    return Texture(image, uv, rows)


def paint(
    image: UInt8[np.ndarray, "h w 3"], layout: Layout, pattern: Pattern, bodies: Bodies, dots: float
) -> Bool[np.ndarray, "h w"]:
    """Paint a layout's triangles at `dots` pixels a metre, every pixel whose centre they hold.

    Each pixel shows the mean of the pattern under it. Returns which pixels were painted [H, W].
    """
    painted = np.zeros(image.shape[:2], bool)
    height, width = painted.shape
    corners = layout.corners * dots
    on_cloth = corner_places(bodies)[:, :, layout.triangles].transpose(2, 1, 0)
    # A pixel's weights of the corners are linear in x and y. Triangles without area, or turned over, hold no pixel.
    linear = np.full((len(corners), 3, 3), -1.0)
    solid = signed_areas(corners) > 0
    linear[solid] = np.linalg.inv(np.concatenate([corners[solid], np.ones((solid.sum(), 3, 1))], axis=2))
    low = np.floor(corners.min(axis=1) - 0.5).astype(int).clip(0)
    high = np.ceil(corners.max(axis=1) + 0.5).astype(int).clip(None, [width, height])
    texels: list[tuple[np.ndarray, ...]] = []
    waiting = 0
    for number, ((x0, y0), (x1, y1)) in enumerate(zip(low, high, strict=True)):
        x, y = (axis.ravel() for axis in np.meshgrid(np.arange(x0, x1), np.arange(y0, y1)))
        weights = np.stack([x + 0.5, y + 0.5, np.ones(len(x))], axis=1) @ linear[number]
        hit = (weights >= 0).all(axis=1)
        face = np.full(hit.sum(), bodies.triangle_face[layout.triangles[number]])
        texels.append((height - 1 - y[hit], x[hit], face, weights[hit] @ on_cloth[number]))
        waiting += len(face)
        if waiting > MOST_TEXELS or number == len(corners) - 1:
            rows, columns, face, at = map(np.concatenate, zip(*texels, strict=True))
            image[rows, columns] = _shown(pattern, bodies, face, at, 1 / dots)
            painted[rows, columns] = True
            texels, waiting = [], 0
    return painted


def _shown(
    pattern: Pattern,
    bodies: Bodies,
    face: Integer[np.ndarray, " n"],
    at: Float[np.ndarray, "n 2"],
    width: float,
) -> UInt8[np.ndarray, "n 3"]:
    """Look up a pattern at points of faces that see `width` metres of a cloth; own colours where it is not worn."""
    position = np.full(bodies.face_count, -1)
    position[pattern.cover.face_ids] = np.arange(len(pattern.cover))
    cloth = np.concatenate([at.T, np.full((2, len(at)), width)]).astype(np.float32)
    worn = pattern.map(Places.on_cloth(torch.from_numpy(position[face]), torch.from_numpy(cloth), len(pattern.cover)))
    colors = worn.apply(torch.from_numpy(np.ascontiguousarray(pattern.colors, np.float32))).numpy()
    is_bare = (worn.crow.diff() == 0).numpy()
    colors[is_bare] = bodies.face_colors[0][face[is_bare]]
    return to_bytes(colors)


def spread(image: UInt8[np.ndarray, "h w 3"], painted: Bool[np.ndarray, "h w"], steps: int) -> None:
    """Grow the painted pixels' colours outwards by some pixels, in place."""
    height, width = painted.shape
    enclosed = painted.copy()
    for axis in (0, 1):
        for shift in (1, -1):
            enclosed &= np.roll(painted, shift, axis)
    y, x = np.nonzero(painted & ~enclosed)
    for _ in range(steps):
        front = []
        for down, across in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            to_y, to_x = y + down, x + across
            free = (to_y >= 0) & (to_y < height) & (to_x >= 0) & (to_x < width)
            free[free] = ~painted[to_y[free], to_x[free]]
            image[to_y[free], to_x[free]] = image[y[free], x[free]]
            painted[to_y[free], to_x[free]] = True
            front.append((to_y[free], to_x[free]))
        y, x = (np.concatenate(side) for side in zip(*front, strict=True))
