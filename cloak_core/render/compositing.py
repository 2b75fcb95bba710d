"""Dressed views, face colours and backgrounds to images, differentiable in the colours alone.

For each pixel a body covers: image = body + (1 - coverage) * background, clamped to [0, 1]. Only the logo's entries
take part in the gradient; the clamp passes it where the sum lies within [0, 1], bounds included.

All that the colours do not decide is done first, on a `Canvas`; what is left for them is one sparse product and a
scatter. Images are channels-last in memory: three neighbouring numbers a pixel, as detectors like them best.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import torch
from jaxtyping import Bool, Float32, Int64, Integer
from torch import Tensor

from cloak_core.render.dressing import DressedView
from cloak_core.render.sparse import csr
from cloak_core.render.threads import one_thread
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
    _check(views, (len(backgrounds), *backgrounds.shape[2:]))
    canvas = blank(len(views), *backgrounds.shape[2:], backgrounds.device)
    pixels_of(canvas, backgrounds.shape).copy_(backgrounds)
    return Canvas.of(views, canvas, shifts, photometric).paint(colors)


def blank(count: int, height: int, width: int, device: torch.device | str = "cpu") -> Float32[Tensor, "P 3"]:
    """Memory for a canvas: a row for each pixel of `count` images, and one more that takes what leaves them."""
    return torch.empty(count * height * width + 1, 3, device=device)


def pixels_of(rows: Float32[Tensor, "P 3"], shape: Sequence[int]) -> Float32[Tensor, "B 3 H W"]:
    """The rows of a canvas as images of this shape; the same memory."""
    batch, _, height, width = shape
    return rows[:-1].view(batch, height, width, 3).permute(0, 3, 1, 2)


@dataclass(frozen=True, eq=False)
class Canvas:
    """B images, finished but for the M pixels (of all of them) that show the logo."""

    rows: Float32[Tensor, "P 3"]
    """Every pixel's colour, and one more row; see `blank`."""
    shape: tuple[int, int, int, int]
    """B, 3, H, W."""
    base: Float32[Tensor, "M 3"]
    """What the logo's pixels show beside the logo: the rest of the body, the highlight, the background at an edge."""
    target: Int64[Tensor, " M"]
    """Their rows. Pixels that nobody sees (a shift moved them out of the image) have the last."""
    lost: Bool[Tensor, " M"] | None
    """Which those are; None: no shift."""
    forward: Tensor
    """CSR [M, B * L]."""
    backward: Tensor
    """CSR [B * L, M], its transpose."""
    scale: Float32[Tensor, "B 1 1"] | Float32[Tensor, "1 3"] | Float32[Tensor, "B 1 3"] | None
    """What the logo's colours are multiplied by: the light's colour, the contrast of the render."""
    change: Photometric | None
    """Of the logo's colours."""
    logo_count: int
    """L."""

    @staticmethod
    def of(
        views: Sequence[DressedView],
        rows: Float32[Tensor, "P 3"],
        shifts: Integer[Tensor, "B 2"] | None = None,
        photometric: Photometric | None = None,
    ) -> Canvas:
        """Put B bodies without their logo before the backgrounds that `rows` holds (see `blank`); it is drawn into."""
        with one_thread():
            return _canvas(views, rows, shifts, photometric)

    def paint(self, colors: Float32[Tensor, "*B L 3"]) -> Float32[Tensor, "B 3 H W"]:
        """The images with these colours, as `compose` gives them. The next call draws into the same memory."""
        batch = self.shape[0]
        if self.logo_count != colors.shape[-2]:
            raise ValueError(f"views are dressed for another logo than these {colors.shape[-2]} colours")
        if self.change is not None:
            if colors.ndim == 2:
                colors = colors.expand(batch, -1, -1)
            colors = _change(colors, self.change)
        if self.scale is not None:
            colors = colors * self.scale
        if colors.ndim == 2:
            colors = colors.expand(batch, -1, -1)
        return _Paint.apply(colors, self)


def _check(views: Sequence[DressedView], wanted: tuple[int, int, int]) -> None:
    if len(views) != wanted[0] or any((view.height, view.width) != wanted[1:] for view in views):
        raise ValueError("views and backgrounds differ in number or size")
    if any(view.logo_count != views[0].logo_count for view in views):
        raise ValueError("views are dressed for logos of different sizes")


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


def _canvas(
    views: Sequence[DressedView], rows: Tensor, shifts: Tensor | None, photometric: Photometric | None
) -> Canvas:
    height, width, count = views[0].height, views[0].width, views[0].logo_count
    _check(views, (len(views), height, width))
    # The logo's pixels of all views first, then those at whose edge the background shows, then the rest.
    parts = [
        (i, start, stop)
        for bounds in (lambda v: (0, v.logo_pixels), lambda v: (v.logo_pixels, v.front_count),
                       lambda v: (v.front_count, len(v.pixels)))
        for i, (start, stop) in enumerate(map(bounds, views))
    ]  # fmt: skip
    pixel = _cat([views[i].pixels[start:stop] for i, start, stop in parts])
    image = torch.cat([pixel.new_full((stop - start,), i) for i, start, stop in parts])
    target = pixel + image * (height * width)
    lost = None
    if shifts is not None:
        target, lost = _shifted(pixel, image, shifts.to(pixel), width, height)
        target.masked_fill_(lost, len(rows) - 1)
    front, logo = sum(view.front_count for view in views), sum(view.logo_pixels for view in views)
    coverage = _cat([views[i].coverage[start:stop] for i, start, stop in parts])[:front].unsqueeze(1)
    body = torch.cat([views[i].planes[:, start:stop].T for i, start, stop in parts])
    scale, change = None, photometric
    if views[0].light_color != (1.0, 1.0, 1.0):
        scale = torch.tensor([views[0].light_color], device=rows.device)
    if photometric is not None and photometric.on == "render":
        body = _change_render(body, image, coverage, photometric)
        scale, change = photometric.contrast.view(-1, 1, 1) * (1 if scale is None else scale), None
    body[:front] += rows.index_select(0, target[:front]).mul_(1 - coverage)
    # One number at a time: torch is twice as fast at that as at rows of three.
    rows.view(-1).scatter_(0, _numbers(target[logo:]), body[logo:].clamp_(0, 1).view(-1))
    forward, backward = _matrices(views, count)
    lost = None if lost is None else lost[:logo].clone()
    shape = (len(views), 3, height, width)
    return Canvas(
        rows, shape, body[:logo].clone(), target[:logo].clone(), lost, forward, backward, scale, change, count
    )


def _matrices(views: Sequence[DressedView], count: int) -> tuple[Tensor, Tensor]:
    """The views' matrices as one of blocks, [M, B * L], and its transpose."""
    starts = _starts([view.logo_pixels for view in views])
    faces = [view.logo_face + i * count if i else view.logo_face for i, view in enumerate(views)]
    forward = _csr([v.logo_crow for v in views], faces, [v.logo_weight for v in views], count * len(views))
    flipped = [view.transposed for view in views]
    columns = [t[1] + start if start else t[1] for t, start in zip(flipped, starts, strict=False)]
    return forward, _csr([t[0] for t in flipped], columns, [t[2] for t in flipped], starts[-1])


def _shifted(
    pixel: Tensor, image: Tensor, shifts: Tensor, width: int, height: int
) -> tuple[Int64[Tensor, " N"], Bool[Tensor, " N"]]:
    """The rows of pixels moved by their image's (dx, dy), and which of them left the image."""
    plane = height * width
    right = shifts[:, 0].index_select(0, image)
    # Looked up: a division of 64-bit integers takes four times as long.
    x = _columns(height, width, pixel.device).index_select(0, pixel).add_(right)
    moved = (shifts[:, 1] * width).index_select(0, image).add_(pixel)
    lost = (x < 0).logical_or_(x >= width).logical_or_(moved < 0).logical_or_(moved >= plane)
    return moved.add_(right).add_(image, alpha=plane), lost


@lru_cache(maxsize=4)
def _columns(height: int, width: int, device: torch.device) -> Int64[Tensor, " P"]:
    """The column of each pixel of an image."""
    return torch.arange(width, device=device).repeat(height)


def _numbers(row: Int64[Tensor, " N"]) -> Int64[Tensor, " N3"]:
    """Positions of the three numbers of each row."""
    return (row.unsqueeze(1) * 3 + torch.arange(3, device=row.device)).view(-1)


def _starts(sizes: Sequence[int]) -> list[int]:
    return [0, *itertools.accumulate(sizes)]


def _cat(tensors: Sequence[Tensor]) -> Tensor:
    return tensors[0] if len(tensors) == 1 else torch.cat(list(tensors), -1)


def _csr(crows: Sequence[Tensor], columns: Sequence[Tensor], values: Sequence[Tensor], width: int) -> Tensor:
    """One sparse matrix of blocks below each other; columns are already those of the whole."""
    starts = _starts([len(column) for column in columns])
    crow = _cat([crow[1:] + start if i else crow for i, (crow, start) in enumerate(zip(crows, starts, strict=False))])
    return csr(crow, _cat(columns), _cat(values), (len(crow) - 1, width))


class _Paint(torch.autograd.Function):
    """Draw the logo; the gradient of the colours is one product with the transposed matrix."""

    @staticmethod
    @one_thread()
    def forward(ctx: object, colors: Float32[Tensor, "B L 3"], canvas: Canvas) -> Float32[Tensor, "B 3 H W"]:
        body = torch.addmm(canvas.base, canvas.forward, colors.reshape(-1, 3))
        values = body.clamp(0, 1)
        canvas.rows.view(-1).scatter_(0, _numbers(canvas.target), values.view(-1))
        silent = values != body
        if canvas.lost is not None:
            silent |= canvas.lost.unsqueeze(1)
        ctx.shape, ctx.matrix = colors.shape, canvas.backward
        ctx.save_for_backward(silent, canvas.target.clamp(max=len(canvas.rows) - 2))
        return pixels_of(canvas.rows, canvas.shape)

    @staticmethod
    @one_thread()
    def backward(ctx: object, gradient: Tensor) -> tuple[Tensor, None]:
        silent, target = ctx.saved_tensors
        if gradient.is_contiguous(memory_format=torch.channels_last):
            upstream = gradient.permute(0, 2, 3, 1).view(-1, 3).index_select(0, target)
        else:
            plane = gradient.shape[2] * gradient.shape[3]
            first = target + torch.div(target, plane, rounding_mode="floor") * (2 * plane)
            channel = torch.arange(3, device=target.device) * plane
            upstream = gradient.reshape(-1).index_select(0, (first.unsqueeze(1) + channel).view(-1)).view(-1, 3)
        return (ctx.matrix @ upstream.masked_fill_(silent, 0)).view(ctx.shape), None


def _change_render(
    body: Float32[Tensor, "N 3"], image: Int64[Tensor, " N"], coverage: Float32[Tensor, "K 1"], change: Photometric
) -> Float32[Tensor, "N 3"]:
    """The body's own pixels, weighted by coverage as they are."""
    added = change.brightness.index_select(0, image).unsqueeze(1).expand_as(body).contiguous()
    if change.noise:
        added += _noise(body.shape, change, body.device)
    added[: len(coverage)] *= coverage
    return torch.addcmul(added, body, change.contrast.index_select(0, image).unsqueeze(1))
