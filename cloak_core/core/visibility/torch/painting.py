"""Bodies composited over backgrounds, and the logo into its pixels and back, in torch.

There are few operations, and none waits for the device.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import torch
from jaxtyping import Bool, Float32, Int64, Integer
from torch import Tensor

from cloak_core.core.linear import LinearMap, SparseMap
from cloak_core.core.view import BakedView

Shifts = Integer[Tensor, "B 2"]


def draw_bodies(
    views: Sequence[BakedView], rows: Float32[Tensor, "P 3"], shifts: Shifts | None
) -> tuple[Float32[Tensor, "M 3"], Int64[Tensor, " M"]]:
    """Composite B bodies, except the M logo pixels, over the rows of a canvas.

    Returns what the logo's pixels show beside the logo, and their rows: the last row for pixels outside the image.
    """
    height, width = views[0].height, views[0].width
    # The logo's pixels of all views first, then those at whose edge the background shows, then the rest.
    parts = [
        (i, start, stop)
        for bounds in (lambda v: (0, v.map.height), lambda v: (v.map.height, v.front_count),
                       lambda v: (v.front_count, len(v.pixels)))
        for i, (start, stop) in enumerate(map(bounds, views))
    ]  # fmt: skip
    pixel = _cat([views[i].pixels[start:stop] for i, start, stop in parts])
    image = torch.cat([pixel.new_full((stop - start,), i) for i, start, stop in parts])
    target = pixel + image * (height * width)
    if shifts is not None:
        target, lost = _shifted(pixel, image, shifts.to(pixel), width, height)
        target.masked_fill_(lost, len(rows) - 1)
    front, logo = sum(view.front_count for view in views), sum(view.map.height for view in views)
    coverage = _cat([views[i].coverage[start:stop] for i, start, stop in parts])[:front].unsqueeze(1)
    body = torch.cat([views[i].base_color[:, start:stop].T for i, start, stop in parts])
    body[:front] += rows.index_select(0, target[:front]).mul_(1 - coverage)
    # One number at a time: torch is twice as fast at that as at rows of three.
    rows.view(-1).scatter_(0, _numbers(target[logo:]), body[logo:].clamp_(0, 1).view(-1))
    return body[:logo].clone(), target[:logo].clone()


@dataclass(frozen=True, eq=False)
class LogoMatrix:
    """The maps from colours to the pixels that show them in B images: sparse ones as the blocks of one, or in turn."""

    maps: Sequence[LinearMap]

    @cached_property
    def _whole(self) -> tuple[Tensor, Tensor] | None:
        """CSR tensors [M, B * L] and its transpose; None where a map is no matrix."""
        if not all(isinstance(each, SparseMap) for each in self.maps):
            return None
        # Each view's transpose is kept with the view, so that it is worked out once.
        backward = SparseMap.blocks([each.transposed for each in self.maps])
        return SparseMap.blocks(self.maps).matrix, backward.matrix

    def paint(
        self, colors: Float32[Tensor, "*B L 3"], base: Float32[Tensor, "M 3"], target: Int64[Tensor, " M"], rows: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Write base + matrix @ colors into the rows `target` of a canvas. Returns what `gradient` needs of it."""
        each = colors.expand(len(self.maps), -1, -1)
        if self._whole is not None:
            body = torch.addmm(base, self._whole[0], each.reshape(-1, 3))
        else:
            body = base + torch.cat([one.apply(own) for one, own in zip(self.maps, each, strict=True)])
        values = body.clamp(0, 1)
        rows.view(-1).scatter_(0, _numbers(target), values.view(-1))
        silent = (values != body).logical_or_((target == len(rows) - 1).unsqueeze(1))
        return silent, target.clamp(max=len(rows) - 2)

    def gradient(
        self, kept: tuple[Tensor, Tensor], upstream: Float32[Tensor, "B 3 H W"], shape: Sequence[int]
    ) -> Float32[Tensor, "*B L 3"]:
        """Compute the gradient of colours of this shape, from that of the images."""
        silent, target = kept
        if upstream.is_contiguous(memory_format=torch.channels_last):
            own = upstream.permute(0, 2, 3, 1).view(-1, 3).index_select(0, target)
        else:
            plane = upstream.shape[2] * upstream.shape[3]
            first = target + torch.div(target, plane, rounding_mode="floor") * (2 * plane)
            channel = torch.arange(3, device=target.device) * plane
            own = upstream.reshape(-1).index_select(0, (first.unsqueeze(1) + channel).view(-1)).view(-1, 3)
        own = own.masked_fill_(silent, 0)
        if self._whole is not None:
            result = (self._whole[1] @ own).view(len(self.maps), -1, 3)
        else:
            parts = own.split([each.height for each in self.maps])
            result = torch.stack([each.adjoint(part) for each, part in zip(self.maps, parts, strict=True)])
        return result.sum_to_size(shape).view(shape)


def logo_matrix(maps: Sequence[LinearMap]) -> LogoMatrix:
    """Put together the maps of B images, each from colours to the pixels that show them."""
    return LogoMatrix(maps)


def _shifted(
    pixel: Tensor, image: Tensor, shifts: Tensor, width: int, height: int
) -> tuple[Int64[Tensor, " N"], Bool[Tensor, " N"]]:
    """Shift pixels by their image's (dx, dy): their rows, and which of them left the image."""
    plane = height * width
    right = shifts[:, 0].index_select(0, image)
    # Looked up: a division of 64-bit integers takes four times as long.
    x = _columns(height, width, pixel.device).index_select(0, pixel).add_(right)
    moved = (shifts[:, 1] * width).index_select(0, image).add_(pixel)
    lost = (x < 0).logical_or_(x >= width).logical_or_(moved < 0).logical_or_(moved >= plane)
    return moved.add_(right).add_(image, alpha=plane), lost


@lru_cache(maxsize=4)
def _columns(height: int, width: int, device: torch.device) -> Int64[Tensor, " P"]:
    """Compute the column of each pixel of an image."""
    return torch.arange(width, device=device).repeat(height)


def _numbers(row: Int64[Tensor, " N"]) -> Int64[Tensor, " N3"]:
    """Positions of the three numbers of each row."""
    return (row.unsqueeze(1) * 3 + torch.arange(3, device=row.device)).view(-1)


def _cat(tensors: Sequence[Tensor]) -> Tensor:
    return tensors[0] if len(tensors) == 1 else torch.cat(list(tensors), -1)
