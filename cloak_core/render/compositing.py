"""Dressed views, face colours and backgrounds to images, differentiable in the colours alone.

For each pixel a body covers: image = body + (1 - coverage) * background, clamped to [0, 1]. Only the logo's entries
take part in the gradient; the clamp passes it where the sum lies within [0, 1], bounds included.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float32, Int64, Integer
from torch import Tensor

from cloak_core.render.sparse import csr
from cloak_core.render.views import DressedView
from cloak_core.scene.cameras import Number


@dataclass(frozen=True)
class Photometric:
    """Changes of brightness for B images: value * contrast + brightness + noise."""

    contrast: Float32[Tensor, " B"]
    brightness: Float32[Tensor, " B"]
    noise: Number = 0.0
    """Amplitude of uniform noise, +-."""
    seed: int = 0
    """Of the noise, for the whole batch."""
    on: Literal["logo", "render"] = "logo"
    """Either the logo's colours, noise per face and channel, or the body's pixels, noise per pixel and channel."""


def compose(
    views: Sequence[DressedView],
    colors: Float32[Tensor, "*B L 3"],
    backgrounds: Float32[Tensor, "B 3 H W"],
    shifts: Integer[Tensor, "B 2"] | None = None,
    photometric: Photometric | None = None,
) -> Float32[Tensor, "B 3 H W"]:
    """Render B dressed views of one logo before B backgrounds.

    colors: the logo's, for all images [L, 3] or for each [B, L, 3]. shifts: (dx, dy) in whole pixels, right and down,
    by which the body moves; what leaves the image is lost. Returns images in [0, 1], never NaN for finite input.
    """
    batch = len(views)
    if len(backgrounds) != batch or any((v.height, v.width) != backgrounds.shape[2:] for v in views):
        raise ValueError("views and backgrounds differ in number or size")
    if any(v.logo_count != colors.shape[-2] for v in views):
        raise ValueError(f"views are dressed for another logo than these {colors.shape[-2]} colours")
    if colors.ndim == 2:
        colors = colors.unsqueeze(0).expand(batch, -1, -1)
    if photometric is not None and photometric.on == "logo":
        colors = _change(colors, photometric)
        photometric = None
    if views[0].light_color != (1.0, 1.0, 1.0):
        colors = colors * torch.tensor(views[0].light_color, device=colors.device)
    return _Compose.apply(colors, _Batch.join(views, shifts), backgrounds, photometric)


def true_boxes(views: Sequence[DressedView], shifts: Integer[Tensor, "B 2"] | None = None) -> Float32[Tensor, "B 4"]:
    """(x0, y0, x1, y1) of each body in its image, pixels, shifted like the body and clipped to the image."""
    device = views[0].pixels.device
    boxes = torch.tensor([view.box for view in views], dtype=torch.float32).to(device)
    if shifts is not None:
        boxes = boxes + shifts.to(device, torch.float32).repeat(1, 2)
    limits = torch.tensor([[v.width, v.height, v.width, v.height] for v in views], dtype=torch.float32).to(device)
    return torch.minimum(boxes.clamp(min=0), limits)


def _change(colors: Float32[Tensor, "B L 3"], change: Photometric) -> Float32[Tensor, "B L 3"]:
    colors = colors * change.contrast.view(-1, 1, 1) + change.brightness.view(-1, 1, 1)
    return colors + _noise(colors.shape, change, colors.device) if change.noise else colors


def _noise(shape: Sequence[int], change: Photometric, device: torch.device) -> Tensor:
    generator = torch.Generator(device=device).manual_seed(change.seed)
    return (torch.rand(shape, generator=generator, device=device) * 2 - 1) * change.noise


@dataclass(frozen=True, eq=False)
class _Batch:
    """B dressed views as one block-diagonal matrix over N pixels, M of them with logo."""

    image: Int64[Tensor, " N"]
    """Which image each pixel belongs to."""
    target: Int64[Tensor, " N"]
    """Flat position of the pixel's first channel in [B, 3, H, W]; the next channels are H * W further on."""
    visible: Bool[Tensor, " N"] | None
    """Whether the pixel is still in the image after the shift; None: all are."""
    coverage: Float32[Tensor, " N"]
    base: Float32[Tensor, "N 3"]
    rows: Int64[Tensor, " M"]
    forward: Tensor
    """CSR [M, B * L]."""
    backward: Tensor
    """CSR [B * L, M], its transpose."""

    @staticmethod
    def join(views: Sequence[DressedView], shifts: Tensor | None) -> _Batch:
        height, width, count = views[0].height, views[0].width, views[0].logo_count
        device = views[0].pixels.device
        sizes = [len(view.pixels) for view in views]
        starts, logo_starts = _starts(sizes), _starts([len(view.logo_rows) for view in views])
        image = torch.cat([torch.full((size,), i, device=device) for i, size in enumerate(sizes)])
        pixel = torch.cat([view.pixels for view in views])
        visible = None
        if shifts is not None:
            shift = shifts.to(device, torch.int64).index_select(0, image)
            y = torch.div(pixel, width, rounding_mode="floor")
            x, y = pixel - y * width + shift[:, 0], y + shift[:, 1]
            visible = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            pixel = torch.where(visible, y * width + x, 0)
        rows = torch.cat([view.logo_rows + start for view, start in zip(views, starts, strict=False)])
        faces = [view.logo_face + i * count for i, view in enumerate(views)]
        weights = [view.logo_weight for view in views]
        forward = _csr([v.logo_crow for v in views], faces, weights, (len(rows), len(views) * count))
        flipped = [view.transposed for view in views]
        columns = [t[1] + start for t, start in zip(flipped, logo_starts, strict=False)]
        backward = _csr([t[0] for t in flipped], columns, [t[2] for t in flipped], (len(views) * count, len(rows)))
        return _Batch(
            image,
            image * (3 * height * width) + pixel,
            visible,
            torch.cat([view.coverage for view in views]),
            torch.cat([view.base for view in views]),
            rows,
            forward,
            backward,
        )


def _starts(sizes: Sequence[int]) -> list[int]:
    return [0, *itertools.accumulate(sizes)]


def _csr(crows: Sequence[Tensor], columns: Sequence[Tensor], values: Sequence[Tensor], size: tuple[int, int]) -> Tensor:
    """One sparse matrix of blocks below each other; columns are already those of the whole."""
    starts = _starts([len(column) for column in columns])
    crow = torch.cat([crow[min(i, 1) :] + start for i, (crow, start) in enumerate(zip(crows, starts, strict=False))])
    return csr(crow, torch.cat(list(columns)), torch.cat(list(values)), size)


class _Compose(torch.autograd.Function):
    """Composite a batch; the gradient of the colours is one product with the transposed matrix."""

    @staticmethod
    def forward(
        ctx: object, colors: Tensor, batch: _Batch, backgrounds: Tensor, change: Photometric | None
    ) -> Float32[Tensor, "B 3 H W"]:
        # One more element than the images have takes what leaves them: no data-dependent shape, no wait for the device.
        flat = torch.cat([backgrounds.reshape(-1), backgrounds.new_zeros(1)])
        images = flat[:-1].view(backgrounds.shape)
        plane = images.shape[2] * images.shape[3]
        channel = torch.arange(3, device=images.device).unsqueeze(1) * plane
        target = batch.target + channel
        pixels = flat.index_select(0, target.view(-1)).view(3, -1)
        behind = pixels * (1 - batch.coverage)
        body = batch.base.T.contiguous()
        logo = (batch.forward @ colors.reshape(-1, 3)).T
        body.index_add_(1, batch.rows, logo)
        if change is not None:
            body = _change_render(body, batch, change)
        sums = body.add_(behind)
        inside = ((sums >= 0) & (sums <= 1)).index_select(1, batch.rows)
        values = sums.clamp_(0, 1)
        if batch.visible is not None:
            inside &= batch.visible.index_select(0, batch.rows)
        lost = target if batch.visible is None else torch.where(batch.visible, target, images.numel())
        flat.scatter_(0, lost.view(-1), values.view(-1))
        ctx.batch, ctx.change, ctx.colors_shape = batch, change, colors.shape
        ctx.save_for_backward(inside, target.index_select(1, batch.rows))
        return images

    @staticmethod
    def backward(ctx: object, gradient: Tensor) -> tuple[Tensor, None, None, None]:
        inside, target = ctx.saved_tensors
        upstream = gradient.contiguous().view(-1).index_select(0, target.view(-1)).view(3, -1)
        upstream = torch.where(inside, upstream, 0)
        if ctx.change is not None:
            rows_image = ctx.batch.image.index_select(0, ctx.batch.rows)
            upstream = upstream * ctx.change.contrast.index_select(0, rows_image)
        return (ctx.batch.backward @ upstream.T.contiguous()).view(ctx.colors_shape), None, None, None


def _change_render(body: Float32[Tensor, "3 N"], batch: _Batch, change: Photometric) -> Float32[Tensor, "3 N"]:
    """The body's own pixels, weighted by coverage as they are."""
    contrast, brightness = (t.index_select(0, batch.image) for t in (change.contrast, change.brightness))
    added = brightness.expand_as(body)
    if change.noise:
        added = added + _noise(body.shape, change, body.device)
    return body * contrast + added * batch.coverage
