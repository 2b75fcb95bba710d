"""Dressed views, face colours and backgrounds to images, differentiable in the colours alone.

For each pixel a body covers: image = body + (1 - coverage) * background, clamped to [0, 1]. Only the logo's entries
take part in the gradient; the clamp passes it where the sum lies within [0, 1], bounds included.

All that the colours do not decide is done first, on a `Canvas`; what is left for them is one sparse product and a
scatter. Images are channels-last in memory: three neighbouring numbers a pixel, as detectors like them best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float32, Int64, Integer
from torch import Tensor
from torch.autograd.graph import increment_version

from cloak_core.render.images import painting, painting_loops
from cloak_core.render.images.dressing import DressedView
from cloak_core.render.images.photometric import Photometric
from cloak_core.render.seam import steps

__all__ = ["Canvas", "Photometric", "blank", "compose", "pixels_of", "true_boxes"]


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
    return Canvas.before(views, backgrounds, shifts, photometric).paint(colors)


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
    logo: painting.LogoMatrix | painting_loops.LogoMatrix
    """What the logo's colours add to them."""
    scale: Float32[Tensor, "B 1 1"] | Float32[Tensor, "1 3"] | Float32[Tensor, "B 1 3"] | None
    """What the logo's colours are multiplied by: the light's colour, the contrast of the render."""
    logo_count: int
    """L."""

    @staticmethod
    def before(
        views: Sequence[DressedView],
        backgrounds: Float32[Tensor, "B 3 H W"],
        shifts: Integer[Tensor, "B 2"] | None = None,
        photometric: Photometric | None = None,
    ) -> Canvas:
        """`of` on a copy of these backgrounds."""
        _check(views, (len(backgrounds), *backgrounds.shape[2:]))
        rows = blank(len(views), *backgrounds.shape[2:], backgrounds.device)
        pixels_of(rows, backgrounds.shape).copy_(backgrounds)
        return Canvas.of(views, rows, shifts, photometric)

    @staticmethod
    def of(
        views: Sequence[DressedView],
        rows: Float32[Tensor, "P 3"],
        shifts: Integer[Tensor, "B 2"] | None = None,
        photometric: Photometric | None = None,
    ) -> Canvas:
        """Put B bodies without their logo before the backgrounds that `rows` holds (see `blank`); it is drawn into."""
        _check(views, (len(views), views[0].height, views[0].width))
        way = steps(rows.device)
        scale = None
        if views[0].light_color != (1.0, 1.0, 1.0):
            scale = torch.tensor([views[0].light_color], device=rows.device)
        if photometric is not None:
            scale = photometric.contrast.view(-1, 1, 1) * (1 if scale is None else scale)
        base, target = way.draw_bodies(views, rows, shifts, photometric)
        logo = way.logo_matrix(views)
        shape = (len(views), 3, views[0].height, views[0].width)
        return Canvas(rows, shape, base, target, logo, scale, views[0].logo_count)

    def paint(self, colors: Float32[Tensor, "*B L 3"]) -> Float32[Tensor, "B 3 H W"]:
        """The images with these colours, as `compose` gives them. The next call draws into the same memory."""
        if self.logo_count != colors.shape[-2]:
            raise ValueError(f"views are dressed for another logo than these {colors.shape[-2]} colours")
        if self.scale is not None:
            colors = colors * self.scale
        if colors.ndim == 3 and len(colors) != self.shape[0]:
            raise ValueError(f"colours for {len(colors)} images, views for {self.shape[0]}")
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


class _Paint(torch.autograd.Function):
    """Draw the logo; the gradient of the colours is one product with the transposed matrix."""

    @staticmethod
    def forward(ctx: object, colors: Float32[Tensor, "*B L 3"], canvas: Canvas) -> Float32[Tensor, "B 3 H W"]:
        kept = canvas.logo.paint(colors, canvas)
        ctx.shape, ctx.logo = colors.shape, canvas.logo
        ctx.save_for_backward(*kept)
        # Loops write where torch does not see it; whoever still needs what was there before shall be told.
        increment_version(canvas.rows)
        return pixels_of(canvas.rows, canvas.shape)

    @staticmethod
    def backward(ctx: object, gradient: Tensor) -> tuple[Tensor, None]:
        return ctx.logo.gradient(ctx.saved_tensors, gradient, ctx.shape), None
