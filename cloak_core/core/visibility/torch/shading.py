"""Light at every fragment, in torch: PyTorch3D's point light under hard Phong shading.

color = surface * (ambient + diffuse * max(0, n.l)) + specular * max(0, v.r)^shininess, with smooth vertex normals
interpolated over the triangle. It is linear in the surface color, which makes a view a sparse matrix.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Float32, Float64, Int64
from torch import Tensor

from cloak_core.core.view import Fragments, Screen, Surface
from cloak_core.core.visibility.settings import Light
from cloak_core.core.visibility.texture import texture_coordinates


def light_fragments(
    found: Fragments, screen: Screen, surface: Surface, normals: Tensor, light_position: Tensor
) -> tuple[Float32[Tensor, " N"], Float32[Tensor, " N"], Float32[Tensor, "2 N"] | None]:
    """Light every fragment: weight of the face's colour and highlight, each times its share of the pixel; and where
    there are textures, coordinates of the point where each fragment is lit. Worked out in float64."""
    corner = surface.triangles.index_select(1, found.triangle)
    position, (w0, w1, w2) = _surface_points(found, screen, corner)
    n0, n1, n2 = (normals.double().index_select(1, corner[i]) for i in range(3))
    weight, highlight = shade(
        position, n0 * w0 + n1 * w1 + n2 * w2, light_position.double().unsqueeze(1), surface.light
    )
    uv = None
    if surface.corner_uv is not None:
        uv = texture_coordinates(surface.corner_uv.index_select(2, found.triangle), w1.float(), w2.float())
    return (weight * found.area).float(), (highlight * found.area).float(), uv


def _surface_points(
    found: Fragments, screen: Screen, corner: Int64[Tensor, "3 N"]
) -> tuple[Float64[Tensor, "3 N"], Float64[Tensor, "3 N"]]:
    """Intersect the rays through fragments' points with their triangles: points in view space, weights of the corners.

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


def shade(
    points: Float[Tensor, "3 N"], normals: Float[Tensor, "3 N"], light_position: Float[Tensor, "xyz=3 #N"], light: Light
) -> tuple[Float[Tensor, " N"], Float[Tensor, " N"]]:
    """Compute the weight of the surface colour and added highlight at points in view space (the camera at the origin).

    normals need not have unit length. Never NaN: a vector of no length counts as facing nowhere.
    """
    normal, toward, away = _unit(normals), _unit(light_position - points), _unit(points)
    cosine = (normal * toward).sum(0)
    # v.r with r = 2 (n.l) n - l, for the negated v.
    reflected = (toward * away).sum(0) - 2 * cosine * (normal * away).sum(0)
    power = torch.where(cosine > 0, reflected.clamp(min=0), 0).pow(light.shininess)
    return light.ambient + light.diffuse * cosine.clamp(min=0), light.specular * power * (cosine > 0)


def _unit(vector: Float[Tensor, "3 N"]) -> Float[Tensor, "3 N"]:
    return vector / torch.linalg.vector_norm(vector, dim=0).clamp(min=1e-20)
