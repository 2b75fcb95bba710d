"""From what is seen of a view to its matrix, in torch: light at every fragment, then a row for each pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float32, Float64, Int64
from torch import Tensor

from cloak_core.render.sparse import offsets
from cloak_core.render.visibility.projection import Screen
from cloak_core.render.weights.fragments import Fragments
from cloak_core.render.weights.shading import Light, shade
from cloak_core.render.weights.texture import texture_coordinates
from cloak_core.render.weights.view import View


@dataclass(frozen=True, eq=False)
class Surface:
    """What of bodies decides a view's matrix, whatever their pose."""

    triangles: Int64[Tensor, "3 T"]
    face: Int64[Tensor, " T"]
    corner_uv: Float32[Tensor, "2 3 T"] | None
    """Texture coordinates, where the bodies have textures."""
    light: Light
    by_face: bool
    """Whether a pixel has one entry for each face; else one for each triangle, which is the same where each is a face.
    Triangles of one polygon may lie far apart on a texture, so with those it is the latter."""


def build_view(
    bands: Sequence[Fragments],
    screen: Screen,
    surface: Surface,
    normals: Float32[Tensor, "3 V"],
    light_position: Float32[Tensor, " 3"],
    count: int,
) -> View:
    """The matrix of the one view on the screen from its fragments, in bands from top to bottom.

    normals (of the vertices) and light position are in view space; count: CPU threads that may share the bands (by
    torch operations one does it all).
    """
    found = Fragments.join(bands)
    weight, highlight, uv = light_fragments(found, screen, surface, normals, light_position)
    face = surface.face.index_select(0, found.triangle)
    pixels, row = torch.unique_consecutive(found.pixel, return_inverse=True)
    coverage, specular = (
        torch.zeros(len(pixels), device=row.device).index_add_(0, row, t) for t in (found.area, highlight)
    )
    if surface.by_face:
        row, face, weight = _merge_faces(row, face, weight)
    crow = offsets(row, len(pixels))
    return View(screen.height, screen.width, pixels, coverage, specular, crow, face, weight, uv)


def light_fragments(
    found: Fragments, screen: Screen, surface: Surface, normals: Tensor, light_position: Tensor
) -> tuple[Float32[Tensor, " N"], Float32[Tensor, " N"], Float32[Tensor, "2 N"] | None]:
    """Weight of the face's colour and highlight of every fragment, each times its share of the pixel; and where
    there are textures, coordinates of the point where each fragment is lit. Worked out in float64."""
    corner = surface.triangles.index_select(1, found.triangle)
    position, (w0, w1, w2) = _met(found, screen, corner)
    n0, n1, n2 = (normals.double().index_select(1, corner[i]) for i in range(3))
    weight, highlight = shade(
        position, n0 * w0 + n1 * w1 + n2 * w2, light_position.double().unsqueeze(1), surface.light
    )
    uv = None
    if surface.corner_uv is not None:
        uv = texture_coordinates(surface.corner_uv.index_select(2, found.triangle), w1.float(), w2.float())
    return (weight * found.area).float(), (highlight * found.area).float(), uv


def _met(
    found: Fragments, screen: Screen, corner: Int64[Tensor, "3 N"]
) -> tuple[Float64[Tensor, "3 N"], Float64[Tensor, "3 N"]]:
    """Where the rays through fragments' points meet their triangles, in view space, and the weights of the corners.

    Works on unsnapped view space, so that it holds for triangles that reach behind the camera, too.
    """
    a, b, c = (torch.stack([axis[0].index_select(0, corner[i]) for axis in screen.view]) for i in range(3))
    focal = screen.focal[0]
    dx, dy = (found.x - screen.width / 2) / focal, (screen.height / 2 - found.y) / focal
    ray = torch.stack([dx, dy, torch.ones_like(dx)])
    # d . (b x c) and so on, proportional to the perspective-correct weights of the corners.
    weights = torch.stack([(ray * torch.linalg.cross(p, q, dim=0)).sum(0) for p, q in ((b, c), (c, a), (a, b))])
    total = weights.sum(0)
    # A triangle seen exactly edge-on has no such point; its first corner stands in.
    weights = weights / total.masked_fill(total == 0, torch.inf)
    weights[0] = 1 - weights[1] - weights[2]
    return ray * (weights * torch.stack([a[2], b[2], c[2]])).sum(0), weights


def _merge_faces(row: Tensor, face: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sum the weights of a polygon's triangles within each pixel."""
    count = int(face.max()) + 1 if len(face) else 1
    entry, inverse = torch.unique(row * count + face, return_inverse=True)
    row = torch.div(entry, count, rounding_mode="floor")
    return row, entry - row * count, weight.new_zeros(len(entry)).index_add_(0, inverse, weight)
