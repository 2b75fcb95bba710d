"""Views, face colours and backgrounds to images, differentiable in the colours alone.

All faces but the logo's are baked into a base image first.

For each pixel a body covers: image = body + (1 - coverage) * background, clamped to [0, 1]. Only the logo's entries
take part in the gradient; the clamp passes it where the sum lies within [0, 1], bounds included.

A `Canvas` holds all that does not depend on the colours; painting them is one sparse product and a scatter. Images are
channels-last in memory: three neighbouring numbers a pixel, which detectors process fastest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float32, Int64, Integer, UInt8
from torch import Tensor
from torch.autograd.graph import increment_version

from cloak_core.core.cameras import Vector
from cloak_core.core.linear import LinearMap, SparseMap
from cloak_core.core.places import Places
from cloak_core.core.view import BakedView, Subject, View
from cloak_core.core.visibility.compiled import backend
from cloak_core.core.visibility.texture import look_up


def bake(
    view: View,
    logo: Int64[Tensor, " L"],
    colors: Float32[Tensor, "F 3"],
    light_color: Vector,
    texture: UInt8[Tensor, "h w 3"] | None = None,
) -> BakedView:
    """Fold all faces but the logo's, in their colours or the texture's, and the highlight into a base image."""
    device = view.pixels.device
    position = torch.full((len(colors),), -1, dtype=torch.int64, device=device)
    position[logo] = torch.arange(len(logo), device=device)
    worn = position.index_select(0, view.map.column)
    is_worn = worn >= 0
    if texture is None:
        body = view.map.apply(colors.index_fill(0, logo, 0.0))
    else:  # each entry has a colour of its own
        rest, entries = view.map.weight.masked_fill(is_worn, 0), torch.arange(len(worn), device=device)
        body = SparseMap(view.map.crow, entries, rest, len(worn)).apply(look_up(texture, view.uv))
    base_color = ((body + view.specular.unsqueeze(1)) * torch.tensor(light_color, device=device)).T

    # The order of `BakedView`: pixels that show the logo, others that the background shows through, the rest.
    entry = is_worn.nonzero().view(-1)
    before = torch.cat([entry.new_zeros(1), is_worn.cumsum(0)])  # entries of the logo up to each entry
    per_row = before.index_select(0, view.map.crow).diff()
    kind = torch.where(per_row > 0, 0, torch.where(view.coverage < 1, 1, 2))
    logo_pixels, edge_pixels, inner_pixels = ((kind == number).nonzero().view(-1) for number in range(3))
    order = torch.cat([logo_pixels, edge_pixels, inner_pixels])
    crow = entry.new_zeros(len(logo_pixels) + 1)
    crow[1:] = per_row.index_select(0, logo_pixels).cumsum(0)
    shown = SparseMap(crow, worn.index_select(0, entry), view.map.weight.index_select(0, entry), len(logo))
    if view.cloth is None:
        places = Places.of_faces(len(logo), device)
    else:
        # The logo's entries keep their order; each is a place of its own.
        places = Places.on_cloth(shown.column, view.cloth.index_select(1, entry), len(logo))
        shown = replace(shown, column=torch.arange(len(entry), device=device), width=len(entry), has_own_columns=True)
    return BakedView(
        view.height,
        view.width,
        view.pixels.index_select(0, order),
        view.coverage.index_select(0, order),
        base_color.index_select(1, order).contiguous(),
        len(logo_pixels) + len(edge_pixels),
        shown,
        places,
        colors.index_select(0, logo),
        light_color,
        Subject(view.box),
    )


def compose(
    views: Sequence[BakedView],
    colors: Float32[Tensor, "*B L 3"],
    backgrounds: Float32[Tensor, "B 3 H W"],
    shifts: Integer[Tensor, "B 2"] | None = None,
) -> Float32[Tensor, "B 3 H W"]:
    """Render B baked views of one logo over B backgrounds.

    The places of the views have colours themselves (`Places.of_faces`).
    colors: the logo's, for all images [L, 3] or for each [B, L, 3]. shifts: (dx, dy) in whole pixels, right and down,
    by which the body moves; what leaves the image is lost. Returns images in [0, 1], never NaN for finite input.
    """
    _check(views, [view.map for view in views], (len(backgrounds), *backgrounds.shape[2:]))
    rows = blank(len(views), *backgrounds.shape[2:], backgrounds.device)
    pixels_of(rows, backgrounds.shape).copy_(backgrounds)
    return Canvas.of(views, rows, shifts).paint(colors)


def blank(count: int, height: int, width: int, device: torch.device | str = "cpu") -> Float32[Tensor, "P 3"]:
    """Allocate a canvas: a row for each pixel of `count` images, and one more for pixels that a shift moves out."""
    return torch.empty(count * height * width + 1, 3, device=device)


def lay_backdrop(
    rows: Float32[Tensor, "P 3"], images: Sequence[UInt8[Tensor, "3 H W"] | None], size: tuple[int, int]
) -> None:
    """Fill a canvas (see `blank`) with one background of `size` (height, width) for each of its images; None: black."""
    for own, image in zip(pixels_of(rows, (len(images), 3, *size)), images, strict=True):
        if image is None:
            own.zero_()
        else:
            # Bytes travel to the device; numbers are made there.
            own.copy_(image.to(own.device, non_blocking=True)).div_(255)


def pixels_of(rows: Float32[Tensor, "P 3"], shape: Sequence[int]) -> Float32[Tensor, "B 3 H W"]:
    """View the rows of a canvas as images of this shape; the same memory."""
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
    """Rows of the logo's pixels; the last row for pixels that a shift moves out of the image."""
    logo: object
    """What the logo's colours add to them: the backend's `LogoMatrix`."""
    scale: Float32[Tensor, "B 1 3"] | None
    """The light's colour, which multiplies the logo's colours; None: white in every image."""
    logo_count: int
    """L."""

    @staticmethod
    def of(
        views: Sequence[BakedView],
        rows: Float32[Tensor, "P 3"],
        shifts: Integer[Tensor, "B 2"] | None = None,
        maps: Sequence[LinearMap] | None = None,
    ) -> Canvas:
        """Composite B bodies without what they wear over the backgrounds in `rows` (see `blank`), in place.

        maps: of each view's first M pixels x colours; None: the places are what has colours.
        """
        maps = [view.map for view in views] if maps is None else maps
        _check(views, maps, (len(views), views[0].height, views[0].width))
        stage = backend(rows.device)
        scale = None
        if any(view.light_color != (1.0, 1.0, 1.0) for view in views):
            scale = torch.tensor([[view.light_color] for view in views], device=rows.device)
        base, target = stage.draw_bodies(views, rows, shifts)
        shape = (len(views), 3, views[0].height, views[0].width)
        return Canvas(rows, shape, base, target, stage.logo_matrix(maps), scale, maps[0].width)

    def paint(self, colors: Float32[Tensor, "*B L 3"]) -> Float32[Tensor, "B 3 H W"]:
        """Draw the images with these colours, as `compose` does. The next call draws into the same memory."""
        if self.logo_count != colors.shape[-2]:
            raise ValueError(f"views are baked for another logo than these {colors.shape[-2]} colours")
        if self.scale is not None:
            colors = colors * self.scale
        if colors.ndim == 3 and len(colors) != self.shape[0]:
            raise ValueError(f"colours for {len(colors)} images, views for {self.shape[0]}")
        return _Paint.apply(colors, self)


def _check(views: Sequence[BakedView], maps: Sequence[LinearMap], expected: tuple[int, int, int]) -> None:
    if len(views) != expected[0] or any((view.height, view.width) != expected[1:] for view in views):
        raise ValueError("views and backgrounds differ in number or size")
    if any(each.width != maps[0].width for each in maps):
        raise ValueError("views are baked for logos of different sizes")


def true_boxes(views: Sequence[BakedView], shifts: Integer[Tensor, "B 2"] | None = None) -> Float32[Tensor, "B 4"]:
    """(x0, y0, x1, y1) of each body in its image, pixels, shifted like the body and clipped to the image."""
    device = views[0].pixels.device
    boxes = torch.tensor([view.box for view in views], dtype=torch.float32).to(device)
    if shifts is not None:
        boxes = boxes + shifts.to(device, torch.float32).repeat(1, 2)
    limits = torch.tensor([[v.width, v.height, v.width, v.height] for v in views], dtype=torch.float32).to(device)
    return torch.minimum(boxes.clamp(min=0), limits)


def body_masks(views: Sequence[BakedView], shifts: Integer[Tensor, "B 2"] | None = None) -> Bool[Tensor, "B H W"]:
    """Mark each person's pixels, shifted like the body; what leaves the image is lost."""
    masks = torch.stack([view.mask for view in views])
    if shifts is None:
        return masks
    moved = torch.zeros_like(masks)
    for k, (right, down) in enumerate(shifts.tolist()):
        y, x = masks[k].nonzero(as_tuple=True)
        y, x = y + down, x + right
        inside = (x >= 0) & (x < masks.shape[2]) & (y >= 0) & (y < masks.shape[1])
        moved[k, y[inside], x[inside]] = True
    return moved


class _Paint(torch.autograd.Function):
    """Draw the logo; the gradient of the colours is one product with the transposed matrix."""

    @staticmethod
    def forward(ctx: object, colors: Float32[Tensor, "*B L 3"], canvas: Canvas) -> Float32[Tensor, "B 3 H W"]:
        kept = canvas.logo.paint(colors, canvas.base, canvas.target, canvas.rows)
        ctx.shape = colors.shape
        ctx.logo = canvas.logo
        ctx.save_for_backward(*kept)
        # Loops write without torch noticing: mark the tensor as changed for graphs that saved its old value.
        increment_version(canvas.rows)
        return pixels_of(canvas.rows, canvas.shape)

    @staticmethod
    def backward(ctx: object, gradient: Tensor) -> tuple[Tensor, None]:
        return ctx.logo.gradient(ctx.saved_tensors, gradient, ctx.shape), None
