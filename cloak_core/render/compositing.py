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
from cloak_core.render.threads import one_thread
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
    """B dressed views as one block-diagonal matrix: N pixels, the logo's M and the front ones of all views first."""

    image: Int64[Tensor, " N"] | None
    """Which image each pixel belongs to; None: there is but one."""
    target: Int64[Tensor, " N"]
    """Flat position of the pixel's first channel in [B, 3, H, W]; the next channels are H * W further on. Pixels that a
    shift moved out of the image have the position behind the last."""
    lost: Bool[Tensor, " N"] | None
    """Which those are; None: no shift."""
    front: int
    """Pixels, from the first on, behind which the background may show."""
    coverage: Float32[Tensor, " K"]
    """Of the front pixels."""
    planes: Float32[Tensor, "3 N"]
    logo: int
    """M."""
    forward: Tensor
    """CSR [M, B * L]."""
    backward: Tensor
    """CSR [B * L, M], its transpose."""

    @staticmethod
    def join(views: Sequence[DressedView], shifts: Tensor | None) -> _Batch:
        height, width, count = views[0].height, views[0].width, views[0].logo_count
        parts = [
            (i, start, stop)
            for bounds in (lambda v: (0, v.logo_pixels), lambda v: (v.logo_pixels, v.front_count),
                           lambda v: (v.front_count, len(v.pixels)))
            for i, (start, stop) in enumerate(map(bounds, views))
        ]  # fmt: skip
        gather = lambda pick: _cat([pick(views[i])[..., start:stop] for i, start, stop in parts])
        pixel = gather(lambda view: view.pixels) if len(views) > 1 else views[0].pixels
        image = None
        if len(views) > 1:
            image = torch.cat([pixel.new_full((stop - start,), i) for i, start, stop in parts])
        lost = None
        if shifts is not None:
            pixel, lost = _shifted(pixel, image, shifts.to(pixel), width, height)
        target = pixel if image is None else pixel + image * (3 * height * width)
        logo_starts = _starts([view.logo_pixels for view in views])
        faces = [view.logo_face + i * count if i else view.logo_face for i, view in enumerate(views)]
        forward = _csr([v.logo_crow for v in views], faces, [v.logo_weight for v in views], count * len(views))
        flipped = [view.transposed for view in views]
        columns = [t[1] + start if start else t[1] for t, start in zip(flipped, logo_starts, strict=False)]
        front = sum(view.front_count for view in views)
        return _Batch(
            image,
            target,
            lost,
            front,
            gather(lambda view: view.coverage)[:front] if len(views) > 1 else views[0].coverage[:front],
            gather(lambda view: view.planes) if len(views) > 1 else views[0].planes,
            logo_starts[-1],
            forward,
            _csr([t[0] for t in flipped], columns, [t[2] for t in flipped], logo_starts[-1]),
        )


def _shifted(
    pixel: Tensor, image: Tensor | None, shifts: Tensor, width: int, height: int
) -> tuple[Int64[Tensor, " N"], Bool[Tensor, " N"]]:
    """Pixels moved by their image's (dx, dy), and which of them left the image."""
    dx, dy = (t if image is None else t.index_select(0, image) for t in shifts.unbind(1))
    x = pixel % width + dx
    y = torch.div(pixel, width, rounding_mode="floor") + dy
    return y * width + x, (x < 0) | (x >= width) | (y < 0) | (y >= height)


def _starts(sizes: Sequence[int]) -> list[int]:
    return [0, *itertools.accumulate(sizes)]


def _cat(tensors: Sequence[Tensor]) -> Tensor:
    return tensors[0] if len(tensors) == 1 else torch.cat(list(tensors), -1)


def _csr(crows: Sequence[Tensor], columns: Sequence[Tensor], values: Sequence[Tensor], width: int) -> Tensor:
    """One sparse matrix of blocks below each other; columns are already those of the whole."""
    starts = _starts([len(column) for column in columns])
    crow = _cat([crow[1:] + start if i else crow for i, (crow, start) in enumerate(zip(crows, starts, strict=False))])
    return csr(crow, _cat(columns), _cat(values), (len(crow) - 1, width))


class _Compose(torch.autograd.Function):
    """Composite a batch; the gradient of the colours is one product with the transposed matrix."""

    @staticmethod
    @one_thread()
    def forward(
        ctx: object, colors: Tensor, batch: _Batch, backgrounds: Tensor, change: Photometric | None
    ) -> Float32[Tensor, "B 3 H W"]:
        # One more element than the images have takes what leaves them: no data-dependent shape, no wait for the device.
        flat = torch.cat([backgrounds.reshape(-1), backgrounds.new_zeros(1)])
        plane, end = backgrounds.shape[2] * backgrounds.shape[3], backgrounds.numel()
        channel = torch.tensor([[0], [plane], [2 * plane]], device=flat.device)
        target = batch.target + channel
        if batch.lost is not None:
            target.masked_fill_(batch.lost, end)
        body = batch.planes.clone()
        body[:, : batch.logo] += (batch.forward @ colors.reshape(-1, 3)).T
        if change is not None:
            body = _change_render(body, batch, change)
        front = target[:, : batch.front]
        body[:, : batch.front] += flat.index_select(0, front.reshape(-1)).view(3, -1).mul_(1 - batch.coverage)
        values = body.clamp(0, 1)
        flat.scatter_(0, target.view(-1), values.view(-1))
        logo = slice(0, batch.logo)
        silent = values[:, logo] != body[:, logo]
        if batch.lost is not None:
            silent |= batch.lost[logo]
        ctx.batch, ctx.change, ctx.shape = batch, change, colors.shape
        ctx.save_for_backward(silent.T, target[:, logo].T.clamp(max=end - 1))
        return flat[:-1].view(backgrounds.shape)

    @staticmethod
    @one_thread()
    def backward(ctx: object, gradient: Tensor) -> tuple[Tensor, None, None, None]:
        silent, target = ctx.saved_tensors
        upstream = gradient.reshape(-1).index_select(0, target.reshape(-1)).view(-1, 3)
        upstream = upstream.masked_fill_(silent, 0)
        if ctx.change is not None:
            contrast = _of_pixels(ctx.change.contrast, ctx.batch)
            upstream = upstream * contrast[: ctx.batch.logo].unsqueeze(1)
        return (ctx.batch.backward @ upstream).view(ctx.shape), None, None, None


def _change_render(body: Float32[Tensor, "3 N"], batch: _Batch, change: Photometric) -> Float32[Tensor, "3 N"]:
    """The body's own pixels, weighted by coverage as they are."""
    added = _of_pixels(change.brightness, batch).expand_as(body).contiguous()
    if change.noise:
        added = added + _noise(body.shape, change, body.device)
    added[:, : batch.front] *= batch.coverage
    return body * _of_pixels(change.contrast, batch) + added


def _of_pixels(values: Float32[Tensor, " B"], batch: _Batch) -> Float32[Tensor, " N"]:
    """Each image's value at its pixels."""
    if batch.image is None:
        return values.expand(len(batch.target))
    return values.index_select(0, batch.image)
