"""Vertices to the snapped screen (screen.py says how), and triangles clipped to the near plane and the guard band.

Clipping (Sutherland-Hodgman) is done in view space, float64. Triangles that share an edge stay watertight: they cut it
in the same point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float64, Int32, Int64
from torch import Tensor

from cloak_core.core.cameras import Camera, Vector
from cloak_core.core.view import Cull, FlatTriangles, Screen
from cloak_core.core.visibility.screen import GRID, GUARD, integers, rounded
from cloak_core.files.errors import InputError


def project(vertices: Float64[Tensor, "B 3 V"], cameras: Sequence[Camera], pivots: Sequence[Vector]) -> Screen:
    """Project one pose per camera to the snapped screen, in float64.

    Raises `InputError` naming the first vertex that is not finite.
    """
    width, height = cameras[0].width, cameras[0].height
    if any((camera.width, camera.height) != (width, height) for camera in cameras):
        raise ValueError("the cameras of one batch must share one image size")
    rows = []
    for camera, pivot in zip(cameras, pivots, strict=True):
        # The x of the axes right, up and forward in the world, then their y, then their z.
        axes = [value for right, up, back in zip(*camera.axes, strict=True) for value in (right, up, -back)]
        rows.append((*camera.position(pivot), *axes, camera.focal, camera.near_plane))
    if not vertices.shape[2]:
        nothing = vertices.new_zeros(len(rows), 0)
        scale = vertices.new_ones(len(rows), 1)
        whole = nothing.to(torch.int32)
        return Screen(width, height, vertices, whole, whole, nothing, None, (0, 0, 0, 0), scale, scale)
    values = torch.tensor(rows, dtype=torch.float64).to(vertices.device).unsqueeze(-1)
    position, axes, focal, near = values[:, :3], values[:, 3:12].unflatten(1, (3, 3)), values[:, 12:13], values[:, 13:]
    x, y, z = (vertices - position).split(1, 1)
    view = (x * axes[:, 0]).add_(y * axes[:, 1]).add_(z * axes[:, 2])
    depth = view[:, 2]
    screen = rounded(view, focal, near, width, height)
    low, high = torch.aminmax(screen, dim=-1)
    focal, near = focal[:, 0], near[:, 0]
    extremes = torch.cat([low.amin(0), high.amax(0), (depth - near).amin().view(1)]).tolist()
    if not all(math.isfinite(value) for value in extremes):
        raise _not_finite(vertices)
    x0, y0, x1, y1, front = extremes
    inside = None
    if front < 0 or max(map(abs, extremes[:4])) > GUARD / 2:
        inside = (depth >= near) & (screen.abs().amax(1) <= GUARD / 2)
    bounds = tuple(int(min(max(value, -GUARD), GUARD)) for value in (x0, x1, y0, y1))
    x, y = integers(screen).unbind(1)
    return Screen(width, height, view, x, y, near / depth.clamp(min=near), inside, bounds, focal, near)


def _not_finite(vertices: Float64[Tensor, "B 3 V"]) -> InputError:
    """Make the error that names a vertex that cannot be projected."""
    # The largest float32 projects without overflow, so the culprit is a vertex of larger float64.
    bad = ~(vertices.abs() <= 1e100)
    if not bad.any():
        return InputError("a camera whose numbers are too far apart to project anything")
    view, axis, vertex = bad.nonzero()[0].tolist()
    value = vertices[view, axis, vertex].item()
    return InputError(f"vertex {vertex} of view {view}: coordinate {'xyz'[axis]} is {value}, not a usable number")


def cut(
    corners: Float64[Tensor, "C D N"], distance: Float64[Tensor, "C N"]
) -> tuple[Float64[Tensor, "K D N"], Int64[Tensor, " N"]]:
    """Keep the part where the distance, linear and given at each corner, is not negative (Sutherland and Hodgman).

    Also returns how many corners each has, 0 where nothing is left. A crossing point is always computed from the inner
    end of its edge towards the outer one, so two polygons that share an edge cut it in the very same point. Beyond a
    polygon's size the last of its corners stands again and again.
    """
    after, following = corners.roll(-1, 0), distance.roll(-1, 0)
    inside, crossing = distance >= 0, distance * following < 0
    start, end = (torch.where(inside.unsqueeze(1), *pair) for pair in ((corners, after), (after, corners)))
    inner, outer = (torch.where(inside, *pair) for pair in ((distance, following), (following, distance)))
    fraction = torch.where(crossing, inner / torch.where(crossing, inner - outer, 1.0), 0.0).unsqueeze(1)
    points = torch.stack([corners, start + fraction * (end - start)], 1).flatten(0, 1)
    emitted = torch.stack([inside, crossing], 1).flatten(0, 1)
    count = emitted.sum(0)
    # Emitted points move up to the front; behind them the last stands again.
    order = torch.argsort(~emitted, dim=0, stable=True)
    room = max(3, int(count.max())) if count.numel() else 3
    slot = torch.arange(room, device=count.device).unsqueeze(1)
    source = order.gather(0, torch.minimum(slot, (count - 1).clamp(min=0)))
    return points.gather(0, source.unsqueeze(1).expand(-1, corners.shape[1], -1)), count


def clip(
    corners: Float64[Tensor, "3 xyz=3 N"],
    focal: Float64[Tensor, " N"],
    near: Float64[Tensor, " N"],
    width: int,
    height: int,
) -> tuple[Int32[Tensor, "3 M"], Int32[Tensor, "3 M"], Float64[Tensor, "3 M"], Int64[Tensor, " M"]]:
    """Cut triangles given in view space to what lies before the near plane and inside the guard band.

    Returns x, y and inverse depth of the corners of M snapped triangles (none, one or several for each), and the index
    of the triangle each is a part of.
    """
    polygon, size = cut(corners, corners[:, 2] - near)
    # Plane by plane. After the near plane depth is positive, so the four sides of the guard band can be tested without
    # dividing by it: |x| * focal <= z * reach.
    for axis, center in ((0, width / 2), (1, height / 2)):
        reach = GUARD / GRID - center  # the guard band is centred on the image's corner, the view on its middle
        for sign in (1.0, -1.0):
            polygon, now = cut(polygon, polygon[:, axis] * focal * sign + polygon[:, 2] * reach)
            size = torch.minimum(now, size * len(polygon))  # what was nothing stays that
    # A convex polygon is a fan of triangles around its first corner.
    part = torch.arange(1, len(polygon) - 1, device=corners.device).unsqueeze(-1)
    fan, owner = (part < size - 1).nonzero(as_tuple=True)
    fan = fan + 1
    pieces = torch.stack([polygon[corner, :, owner] for corner in (torch.zeros_like(fan), fan, fan + 1)])
    x, y = integers(rounded(pieces.transpose(1, 2), focal[owner], near[owner], width, height)).unbind(1)
    return x, y, near[owner] / pieces[..., 2], owner


def flatten(screen: Screen, triangles: Int64[Tensor, "3 T"], view: int, cull: Cull = None) -> FlatTriangles:
    """List the triangles of one view, without those behind its near plane.

    Parts of clipped triangles come last and keep their triangle's id.
    """
    x, y, inverse_depth = (t[view] for t in (screen.x, screen.y, screen.inverse_depth))
    ids = torch.arange(triangles.shape[1], device=x.device)
    one_sided = torch.zeros_like(ids, dtype=torch.bool) if cull is None else cull[view].to(x.device).expand(len(ids))
    if screen.in_guard_band is None:
        return FlatTriangles(x, y, inverse_depth, triangles, ids, one_sided)
    whole = screen.in_guard_band[view][triangles].all(0)
    ahead = (screen.view[view, 2] >= screen.near[view])[triangles].any(0)
    # Only triangles that cross a plane are clipped: those of most views are none.
    crossing = (ahead & ~whole).nonzero().view(-1)
    corners = screen.view[view][:, triangles[:, crossing]].transpose(0, 1)
    focal, near = (t[view].expand(len(crossing)) for t in (screen.focal, screen.near))
    *parts, owner = clip(corners, focal, near, screen.width, screen.height)
    corner = torch.arange(len(x), len(x) + 3 * len(owner), device=x.device).view(3, -1)
    return FlatTriangles(
        *(torch.cat([kept, part.view(-1)]) for kept, part in zip((x, y, inverse_depth), parts, strict=True)),
        torch.cat([triangles[:, whole], corner], 1),
        torch.cat([ids[whole], crossing[owner]]),
        torch.cat([one_sided[whole], one_sided[crossing[owner]]]),
    )
