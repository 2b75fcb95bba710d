"""Fragments to a view's matrix, in torch: light at every fragment, then a row for each pixel.

PyTorch3D's point light under hard Phong shading: color = surface * (ambient + diffuse * max(0, n.l)) + specular *
max(0, v.r)^shininess, with smooth vertex normals interpolated over the triangle. It is linear in the surface color,
which makes a view a sparse matrix. On CUDA one Triton kernel lights bodies without textures and cloths.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Float32, Float64, Int64
from torch import Tensor

from cloak_core.core.linear import SparseMap, offsets
from cloak_core.core.view import Fragments, Screen, Surface, View
from cloak_core.core.visibility.compiled import use_kernels
from cloak_core.core.visibility.settings import Light
from cloak_core.core.visibility.texture import texture_coordinates


def light_fragments(
    fragments: Fragments, screen: Screen, surface: Surface, normals: Tensor, light_position: Tensor
) -> tuple[Float32[Tensor, " N"], Float32[Tensor, " N"], Float32[Tensor, "2 N"] | None, Float32[Tensor, "4 N"] | None]:
    """Light every fragment: weight of the face's colour and highlight, each times its share of the pixel; and where
    there are textures or a cloth, coordinates of the point where each fragment is lit, on the cloth its extent, too.
    Worked out in float64."""
    corner = surface.triangles.index_select(1, fragments.triangle)
    position, weights, crosses, total = _surface_points(fragments, screen, corner)
    normal = (_at_corners(normals, corner) * weights).sum(1)
    weight, highlight = shade(position, normal, light_position.double().unsqueeze(1), surface.light)
    uv = cloth = None
    if surface.corner_uv is not None:
        uv = texture_coordinates(surface.corner_uv.index_select(2, fragments.triangle), *weights[1:].float())
    if surface.corner_cloth is not None:
        corners = surface.corner_cloth.index_select(2, fragments.triangle)
        side = fragments.area.double().sqrt() / screen.focal[0]
        extent = _extents(corners.double(), weights, crosses, total, side).float()
        cloth = torch.cat([texture_coordinates(corners, *weights[1:].float(), inset=0.0), extent])
    return (weight * fragments.area).float(), (highlight * fragments.area).float(), uv, cloth


def _extents(
    corners: Float64[Tensor, "2 3 N"],
    weights: Float64[Tensor, "3 N"],
    crosses: Float64[Tensor, "3 3 N"],
    total: Float64[Tensor, " N"],
    side: Float64[Tensor, " N"],
) -> Float64[Tensor, "2 N"]:
    """How far fragments reach on the cloth: see `_extent` of the loops."""
    here = (corners * weights).sum(1)
    # By the ray's two coordinates: [cloth's axes, ray's axes, N].
    along = torch.einsum("acn,ckn->akn", corners, crosses[:, :2])
    slope = (along - here.unsqueeze(1) * crosses[:, :2].sum(0)) / total.masked_fill(total == 0, torch.inf)
    return torch.minimum(slope.abs().sum(1) * side, corners.amax(1) - corners.amin(1))


def _surface_points(
    fragments: Fragments, screen: Screen, corner: Int64[Tensor, "3 N"]
) -> tuple[Float64[Tensor, "3 N"], Float64[Tensor, "3 N"], Float64[Tensor, "3 3 N"], Float64[Tensor, " N"]]:
    """Intersect the rays through fragments' points with their triangles: points in view space, weights of the corners;
    and what these come from: corners' crosses, and the sum of their products with the ray.

    Works on unsnapped view space, so that it holds for triangles that reach behind the camera, too.
    """
    space = _at_corners(screen.view[0], corner)
    focal = screen.focal[0]
    across, up = fragments.x - screen.width / 2, screen.height / 2 - fragments.y
    ray = torch.stack([across, up, focal.expand_as(up)]) / focal
    # d . (b x c) and so on, proportional to the perspective-correct weights of the corners.
    crosses = torch.linalg.cross(space.roll(-1, 1), space.roll(-2, 1), dim=0).transpose(0, 1)
    weights = (ray * crosses).sum(1)
    total = weights.sum(0)
    # A triangle seen exactly edge-on has no such point; its first corner stands in.
    weights = weights / total.masked_fill(total == 0, torch.inf)
    weights[0] = 1 - weights[1] - weights[2]
    return ray * (weights * space[2]).sum(0), weights, crosses, total


def _at_corners(values: Float[Tensor, "3 V"], corner: Int64[Tensor, "3 N"]) -> Float64[Tensor, "xyz=3 corner=3 N"]:
    """Gather vectors of the vertices at the corners of triangles."""
    return values.index_select(1, corner.view(-1)).view(3, *corner.shape).double()


def shade(
    points: Float[Tensor, "3 N"], normals: Float[Tensor, "3 N"], light_position: Float[Tensor, "xyz=3 #N"], light: Light
) -> tuple[Float[Tensor, " N"], Float[Tensor, " N"]]:
    """Compute the weight of the surface colour and added highlight at points in view space (the camera at the origin).

    normals need not have unit length. Never NaN: a vector of no length counts as facing nowhere.
    """
    vectors = torch.stack([normals, light_position - points, points])
    vectors = vectors / torch.linalg.vector_norm(vectors, dim=1, keepdim=True).clamp(min=1e-20)
    cosine, across, back = (vectors * vectors.roll(-1, 0)).sum(1)  # normal . light, light . point, point . normal
    # v.r with r = 2 (n.l) n - l, for the negated v.
    reflected = across - 2 * cosine * back
    power = reflected.clamp(min=0).pow(light.shininess)
    return light.ambient + light.diffuse * cosine.clamp(min=0), light.specular * power * (cosine > 0)


def build_view(
    fragments: Fragments,
    screen: Screen,
    surface: Surface,
    normals: Float32[Tensor, "3 V"],
    light_position: Float32[Tensor, " 3"],
) -> View:
    """Light the fragments of one view, or a band of it, and sum them up to its matrix.

    normals (of the vertices) and light position are in view space.
    """
    light = light_fragments
    if use_kernels(normals.device) and surface.corner_uv is None and surface.corner_cloth is None:
        from cloak_core.core.visibility.fused import light_fragments as light  # needs Triton
    weight, highlight, uv, cloth = light(fragments, screen, surface, normals, light_position)
    face = surface.face.index_select(0, fragments.triangle)
    pixels, row = torch.unique_consecutive(fragments.pixel, return_inverse=True)
    lit = torch.stack([fragments.area, highlight])
    coverage, specular = torch.zeros(2, len(pixels), device=row.device).index_add_(1, row, lit)
    if surface.by_face:
        # The weights of a polygon's triangles within each pixel are summed.
        entry, inverse = torch.unique(row * surface.face_count + face, return_inverse=True)
        row = torch.div(entry, surface.face_count, rounding_mode="floor")
        face = entry - row * surface.face_count
        weight = weight.new_zeros(len(entry)).index_add_(0, inverse, weight)
    entries = SparseMap(offsets(row, len(pixels)), face, weight, surface.face_count)
    return View(screen.height, screen.width, pixels, coverage, specular, entries, uv, cloth)
