"""Face colours as a picture on a layout, and the whole body's texture coordinates into it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer, UInt8

from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.products.layout import Layout, inside
from cloak_core.sources.bodies.meshes.pictures import color_squares, to_bytes

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


def bake(bodies: Bodies, layout: Layout, face_colors: Float32[np.ndarray, "faces 3"], dpi: int) -> Texture:
    """Paint the colours of all faces ([F, 3] sRGB, the logo's among them) at `dpi` dots to the inch of the layout."""
    dots = dpi / 0.0254
    width, rows = (int(np.ceil(extent * dots)) for extent in layout.size)
    plain = np.setdiff1d(np.arange(bodies.triangle_count), layout.triangles)
    squares, centres = color_squares(face_colors[bodies.triangle_face[plain]], width)
    height = rows + len(squares)
    if width * height > MAX_PIXELS:
        raise InputError(f"{dpi} dpi: a picture of {width} x {height} pixels is too large")
    image = np.full((height, width, 3), 255, np.uint8)
    colors = to_bytes(face_colors[bodies.triangle_face[layout.triangles]])
    painted = paint(image[:rows], layout.corners * dots, colors)
    spread(image[:rows], painted, int(np.ceil(PADDING * dots)))
    image[rows:] = squares
    uv = np.zeros((bodies.triangle_count, 3, 2))
    uv[layout.triangles] = (layout.corners * dots + [0, height - rows]) / [width, height]
    uv[plain] = ((centres + np.array([0, rows])) / [width, height] * [1, -1] + [0, 1])[:, None]
    return Texture(image, uv, rows)


def paint(
    image: UInt8[np.ndarray, "h w 3"], corners: Float[np.ndarray, "t 3 2"], colors: UInt8[np.ndarray, "t 3"]
) -> Bool[np.ndarray, "h w"]:
    """Fill triangles (pixels, y up from the picture's lower border) with plain colours, every pixel whose centre they
    hold; returns which pixels were filled [H, W]."""
    painted = np.zeros(image.shape[:2], bool)
    height, width = painted.shape
    low = np.floor(corners.min(axis=1) - 0.5).astype(int)
    high = np.ceil(corners.max(axis=1) + 0.5).astype(int)
    for triangle, color, (x0, y0), (x1, y1) in zip(corners, colors, low, high, strict=True):
        x = np.arange(max(x0, 0), min(x1, width))
        y = np.arange(max(y0, 0), min(y1, height))
        points = np.stack(np.meshgrid(x + 0.5, y + 0.5), axis=-1).reshape(-1, 2)
        hit = inside(triangle, points).reshape(len(y), len(x))
        rows, columns = np.nonzero(hit)
        image[height - 1 - y[rows], x[columns]] = color
        painted[height - 1 - y[rows], x[columns]] = True
    return painted


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


def dressed(
    bodies: Bodies, face_ids: Integer[np.ndarray, " logo"], colors: Float32[np.ndarray, "logo 3"]
) -> Float32[np.ndarray, "faces 3"]:
    """Give all faces' colours: the first outfit with the logo on it."""
    all_colors = bodies.face_colors[0].copy()
    all_colors[face_ids] = colors
    return all_colors
