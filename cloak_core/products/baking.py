"""Face colours, or a cloth, as a picture on a layout, and the whole body's texture coordinates into it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer, UInt8

from cloak_core.core.cloth import corner_places
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.products.layout import Layout, inside
from cloak_core.sources.bodies.meshes.pictures import color_squares, to_bytes
from cloak_core.studies.printed_cloth import PrintedCloth

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


@dataclass(frozen=True, eq=False)
class Sewn:
    """A cloth on the triangles of a layout: which of its colours each point shows."""

    cloth: PrintedCloth
    corners: Float[np.ndarray, "t 3 2"]
    """In the picture, pixels, y up."""
    places: Float[np.ndarray, "t 3 2"]
    """On the cloth, metres right and down."""

    def colors_at(self, number: int, points: Float[np.ndarray, "n 2"]) -> UInt8[np.ndarray, "n 3"]:
        """Look up points (pixels) of one triangle on the cloth, affinely from corner to corner."""
        corners, places = self.corners[number], self.places[number]
        across = (points - corners[0]) @ np.linalg.pinv(corners[1:] - corners[0])
        squares = self.cloth.cloth.square_at(places[0] + across @ (places[1:] - places[0]))
        return to_bytes(self.cloth.colors[squares])


def bake(
    bodies: Bodies,
    layout: Layout,
    face_colors: Float32[np.ndarray, "faces 3"],
    dpi: int,
    cloth: PrintedCloth | None = None,
) -> Texture:
    """Paint the colours of all faces ([F, 3] sRGB, the logo's among them) at `dpi` dots to the inch of the layout.

    cloth: what the logo's faces show in place of their colours, as fine as it is printed.
    """
    dots = dpi / 0.0254
    width, rows = (int(np.ceil(extent * dots)) for extent in layout.size)
    plain = np.setdiff1d(np.arange(bodies.triangle_count), layout.triangles)
    squares, centres = color_squares(face_colors[bodies.triangle_face[plain]], width)
    height = rows + len(squares)
    if width * height > MAX_PIXELS:
        raise InputError(f"{dpi} dpi: a picture of {width} x {height} pixels is too large")
    image = np.full((height, width, 3), 255, np.uint8)
    colors = to_bytes(face_colors[bodies.triangle_face[layout.triangles]])
    corners = layout.corners * dots
    places = None if cloth is None else corner_places(bodies)[:, :, layout.triangles].transpose(2, 1, 0)
    painted = paint(image[:rows], corners, colors, None if cloth is None else Sewn(cloth, corners, places))
    spread(image[:rows], painted, int(np.ceil(PADDING * dots)))
    image[rows:] = squares
    uv = np.zeros((bodies.triangle_count, 3, 2))
    uv[layout.triangles] = (layout.corners * dots + [0, height - rows]) / [width, height]
    uv[plain] = ((centres + np.array([0, rows])) / [width, height] * [1, -1] + [0, 1])[:, None]
    return Texture(image, uv, rows)


def paint(
    image: UInt8[np.ndarray, "h w 3"],
    corners: Float[np.ndarray, "t 3 2"],
    colors: UInt8[np.ndarray, "t 3"],
    sewn: Sewn | None = None,
) -> Bool[np.ndarray, "h w"]:
    """Fill triangles (pixels, y up from the picture's lower border) with plain colours or a cloth, every pixel whose
    centre they hold; returns which pixels were filled [H, W]."""
    painted = np.zeros(image.shape[:2], bool)
    height, width = painted.shape
    low = np.floor(corners.min(axis=1) - 0.5).astype(int)
    high = np.ceil(corners.max(axis=1) + 0.5).astype(int)
    for number, (triangle, color, (x0, y0), (x1, y1)) in enumerate(zip(corners, colors, low, high, strict=True)):
        x = np.arange(max(x0, 0), min(x1, width))
        y = np.arange(max(y0, 0), min(y1, height))
        points = np.stack(np.meshgrid(x + 0.5, y + 0.5), axis=-1).reshape(-1, 2)
        hit = inside(triangle, points)
        rows, columns = np.nonzero(hit.reshape(len(y), len(x)))
        shown = color if sewn is None else sewn.colors_at(number, points[hit])
        image[height - 1 - y[rows], x[columns]] = shown
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
