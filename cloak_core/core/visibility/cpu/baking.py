"""A view split into the logo's matrix and the base colours, as numba loops: one pixel after the other."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from cloak_core.core.cameras import Vector
from cloak_core.core.linear import SparseMap
from cloak_core.core.view import View
from cloak_core.core.visibility.compiled import arrays, loop

ZERO, HALF, ONE, WHITE = np.float32(0), np.float32(0.5), np.float32(1), np.float32(255)


def split(
    view: View, logo: Int64[Tensor, " L"], colors: Float32[Tensor, "F 3"], light_color: Vector, texture: Tensor | None
) -> tuple[Tensor, Tensor, Tensor, int, SparseMap]:
    """See `torch/baking.py`."""
    pixels, coverage = view.pixels, view.coverage
    crow, face, weight = view.map.crow, view.map.column, view.map.weight
    position = torch.full((len(colors),), -1)
    position[logo] = torch.arange(len(logo))
    kind = torch.empty(len(pixels), dtype=torch.uint8)
    rows = arrays(crow, face, position, coverage, kind)
    logo_rows, edge_rows, entries = _sort(*rows)
    ours = (pixels.new_empty(len(pixels)), coverage.new_empty(len(pixels)), colors.new_empty(3, len(pixels)))
    matrix = (crow.new_empty(logo_rows + 1), face.new_empty(entries), weight.new_empty(entries))
    no_texture = torch.empty(0, 0, 3, dtype=torch.uint8)
    surface = arrays(
        torch.empty(2, 0) if view.uv is None else view.uv, no_texture if texture is None else texture, colors
    )  # fmt: skip
    tint = np.array(light_color, np.float32)
    rest = arrays(pixels, view.specular, weight, *ours, *matrix)
    _fill(*rows, *surface, tint, np.array([0, logo_rows, logo_rows + edge_rows]), *rest)
    return *ours[:3], logo_rows + edge_rows, SparseMap(*matrix, len(logo))


@loop
def _sort(crow, face, position, coverage, kind):
    """Classify pixels: with logo 0, others at edges 1, the rest 2. Returns how many of 0 and 1, and logo entries."""
    logo_rows = edge_rows = entries = 0
    for n in range(len(kind)):
        before = entries
        for entry in range(crow[n], crow[n + 1]):
            if position[face[entry]] >= 0:
                entries += 1
        if entries > before:
            kind[n] = 0
            logo_rows += 1
        elif coverage[n] < ONE:
            kind[n] = 1
            edge_rows += 1
        else:
            kind[n] = 2
    return logo_rows, edge_rows, entries


@loop
def _fill(
    crow, face, position, coverage, kind, uv, texture, colors, tint, places, pixels, specular, weight,
    to_pixels, to_coverage, to_base_color, to_crow, to_face, to_weight,
):  # fmt: skip
    """Move every pixel to its kind's next place; the logo's entries go to the matrix, all others are summed up."""
    textured = texture.size > 0
    filled = 0
    to_crow[0] = 0
    for n in range(len(kind)):
        place = places[kind[n]]
        places[kind[n]] += 1
        red = green = blue = ZERO
        for entry in range(crow[n], crow[n + 1]):
            part = weight[entry]
            at = position[face[entry]]
            if at >= 0:
                to_face[filled], to_weight[filled] = at, part
                filled += 1
            elif textured:
                r, g, b = _look_up(texture, uv[0, entry], uv[1, entry])
                red, green, blue = red + part * r, green + part * g, blue + part * b
            else:
                f = face[entry]
                red += part * colors[f, 0]
                green += part * colors[f, 1]
                blue += part * colors[f, 2]
        if kind[n] == 0:
            to_crow[place + 1] = filled
        to_pixels[place] = pixels[n]
        to_coverage[place] = coverage[n]
        to_base_color[0, place] = (red + specular[n]) * tint[0]
        to_base_color[1, place] = (green + specular[n]) * tint[1]
        to_base_color[2, place] = (blue + specular[n]) * tint[2]


@loop
def _look_up(texture, u, v):
    """Look up a texture bilinearly: `texture.look_up` at one point."""
    height, width = texture.shape[:2]
    x, y = (u % ONE) * np.float32(width) - HALF, (ONE - v % ONE) * np.float32(height) - HALF
    column, row = math.floor(x), math.floor(y)
    fx, fy = x - np.float32(column), y - np.float32(row)
    left, right = column % width, (column + 1) % width
    top, bottom = row % height, (row + 1) % height
    upper_left, upper_right = (ONE - fx) * (ONE - fy), fx * (ONE - fy)
    lower_left, lower_right = (ONE - fx) * fy, fx * fy
    red = green = blue = ZERO
    for i, j, part in (
        (top, left, upper_left), (top, right, upper_right), (bottom, left, lower_left), (bottom, right, lower_right),
    ):  # fmt: skip
        red += np.float32(texture[i, j, 0]) * part
        green += np.float32(texture[i, j, 1]) * part
        blue += np.float32(texture[i, j, 2]) * part
    return red / WHITE, green / WHITE, blue / WHITE
