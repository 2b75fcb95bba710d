"""The triangles of one view as loops take them: with those that need it clipped already."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float64, Int32, Int64
from torch import Tensor

from cloak_core.render.visibility.clipping import clip
from cloak_core.render.visibility.projection import Screen

Cull = Bool[Tensor, " B"] | Bool[Tensor, "B T"] | None
"""Which views or, in each, which triangles are dropped where they show their back; None: none."""


@dataclass(frozen=True)
class FlatTriangles:
    """N triangles on the snapped screen, between K corners."""

    x: Int32[Tensor, " K"]
    y: Int32[Tensor, " K"]
    nearness: Float64[Tensor, " K"]
    corner: Int64[Tensor, "3 N"]
    ids: Int64[Tensor, " N"]
    one_sided: Bool[Tensor, " N"]
    """Whether they are dropped where they show their back."""

    def arrays(self) -> list:
        """As numpy arrays, in this order."""
        return [t.contiguous().numpy() for t in (self.x, self.y, self.nearness, self.corner, self.ids, self.one_sided)]


def flatten(screen: Screen, triangles: Int64[Tensor, "3 T"], view: int, cull: Cull = None) -> FlatTriangles:
    """All triangles of one view but those behind its near plane; parts of clipped ones come last and keep their
    triangle's id."""
    x, y, nearness = (t[view] for t in (screen.x, screen.y, screen.nearness))
    ids = torch.arange(triangles.shape[1], device=x.device)
    one_sided = torch.zeros_like(ids, dtype=torch.bool) if cull is None else cull[view].to(x.device).expand(len(ids))
    if screen.safe is None:
        return FlatTriangles(x, y, nearness, triangles, ids, one_sided)
    whole = screen.safe[view][triangles].all(0)
    ahead = (screen.view[2][view] >= screen.near[view])[triangles].any(0)
    cut = (ahead & ~whole).nonzero().view(-1)
    corners = torch.stack([axis[view][triangles[:, cut]] for axis in screen.view], 1)
    focal, near = (t[view].expand(len(cut)) for t in (screen.focal, screen.near))
    soup, owner = clip(corners, focal, near, screen.width, screen.height)
    return FlatTriangles(
        torch.cat([x, soup.x.view(-1)]),
        torch.cat([y, soup.y.view(-1)]),
        torch.cat([nearness, soup.nearness]),
        torch.cat([triangles[:, whole], soup.corner + len(x)], 1),
        torch.cat([ids[whole], cut[owner]]),
        torch.cat([one_sided[whole], one_sided[cut[owner]]]),
    )
