"""Views from photographs: where a fitted person's pixels lie on clothes, and how an image shows them.

The image is a square part of the photograph, resampled. Resampling is linear: what is worn goes to the photograph's
pixels first, then through the same two kernels as the photograph.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64
from torch import Tensor

from cloak_core.core.cameras import Number
from cloak_core.core.linear import SparseMap
from cloak_core.core.places import Places
from cloak_core.core.view import BakedView, Subject
from cloak_core.sources.photographs.fitting import Fit, entries_of_rows
from cloak_core.sources.photographs.person import Box
from cloak_core.sources.photographs.resampling import Kernel, Resampling, photograph, resample
from cloak_core.sources.photographs.rig import faces_on_rig

PADDING = 0.5
"""Grey beyond the photograph's border."""
CONTEXT = 1.25
"""Side of the image that judges, in heights of the person's box."""


@dataclass(frozen=True)
class Framing:
    """Which part of a person's crop an image shows, and how it is resampled."""

    x: Number
    y: Number
    """Left top corner of the square, pixels of the crop; may lie outside."""
    side: Number
    size: int = 416
    """Pixels of the image."""
    mirror: bool = False
    softness: Number = 1.0
    """Width of the resampling kernel, 1: just enough against aliasing."""

    def box(self, box: Box) -> Box:
        """A box of the crop in pixels of the image."""
        x0, y0, x1, y1 = (
            (value - start) * self.size / self.side for value, start in zip(box, (self.x, self.y) * 2, strict=True)
        )
        return (self.size - x1, y0, self.size - x0, y1) if self.mirror else (x0, y0, x1, y1)


@dataclass(frozen=True)
class FitJitter:
    """What a fit does not know: changes of it that training draws."""

    move: tuple[Number, Number] = (0.0, 0.0)
    """Of the faces on the person, in heights of her box, right and down."""
    stretch: tuple[Number, Number] = (1.0, 1.0)
    """Of the faces about her middle, across and along. A cloth, which is laid by metres, becomes finer by as much."""
    folds: Number = 1.0
    """Exponent of the shading."""
    exposure: Number = 1.0


EXACT = FitJitter()


def framing_of(fit: Fit, context: Number = CONTEXT, size: int = 416) -> Framing:
    """The square about a person that judges: `context` heights of her box, moved into the photograph where it fits."""
    x0, y0, x1, y1 = fit.person.box
    side = context * max(y1 - y0, x1 - x0)
    return Framing(*square_at(fit, (x0 + x1 - side) / 2, (y0 + y1 - side) / 2, side), side, size)


def square_at(fit: Fit, x: Number, y: Number, side: Number) -> tuple[Number, Number]:
    """Move a square of the crop into the photograph where it fits; else it shows as much beyond on both sides."""
    height, width = fit.person.shape
    inside = lambda start, most: min(max(start, 0.0), most - side) if side <= most else (most - side) / 2
    return inside(x, width), inside(y, height)


def logo_positions(topology: str, face_ids: Int64[np.ndarray, " L"]) -> Int64[np.ndarray, " T"]:
    """For each of the rig's triangles the position of its face in the logo; -1 where it is not of the logo."""
    face = faces_on_rig(topology)
    position = np.full(max(int(face.max()), int(face_ids.max())) + 1, -1)
    position[face_ids] = np.arange(len(face_ids))
    return np.where(face >= 0, position[face], -1)


def shares_of(fit: Fit, position: Int64[np.ndarray, " T"], count: int, jitter: FitJitter) -> SparseMap:
    """Lay a logo onto a fit: its pixels x the logo's `count` faces, each entry the face's share of the pixel."""
    crow, triangle, share = fit.crow, fit.triangle, fit.share
    if jitter.move != (0.0, 0.0) or jitter.stretch != (1.0, 1.0):
        (height, width), (x0, y0, x1, y1) = fit.person.shape, fit.person.box
        x, y = fit.pixels % width, fit.pixels // width
        from_x = (x0 + x1) / 2 + (x - (x0 + x1) / 2) / jitter.stretch[0] - jitter.move[0] * (y1 - y0)
        from_y = (y0 + y1) / 2 + (y - (y0 + y1) / 2) / jitter.stretch[1] - jitter.move[1] * (y1 - y0)
        column, row = np.clip(np.rint(from_x), 0, width - 1), np.clip(np.rint(from_y), 0, height - 1)
        number = np.full(height * width, -1)
        number[fit.pixels] = np.arange(len(fit.pixels))
        rows = number[row.astype(int) * width + column.astype(int)]
        # Where the move leads off the person a pixel keeps its own faces.
        rows = np.where(rows >= 0, rows, np.arange(len(rows)))
        counts = np.diff(crow)[rows]
        entry = entries_of_rows(crow[rows], counts)
        crow, triangle, share = np.concatenate([[0], np.cumsum(counts)]), triangle[entry], share[entry]
    face = position[triangle]
    kept = face >= 0
    before = np.concatenate([[0], np.cumsum(kept)])
    weight = torch.from_numpy(share[kept].astype(np.float32))
    return SparseMap(torch.from_numpy(before[crow]), torch.from_numpy(face[kept]), weight, count)


def places_of(fit: Fit, position: Int64[np.ndarray, " T"], count: int, jitter: FitJitter = EXACT) -> Places:
    """Find where each of a fit's pixels lies on clothes that wear `count` faces (`logo_positions`).

    A pixel sees a square of cloth of its own size at the scale of the fit, wider and taller as the fit may err.
    """
    stretch = np.array(jitter.stretch, np.float32)[:, None]
    at = fit.on_cloth * stretch
    extent = np.broadcast_to(stretch / np.float32(fit.scale), at.shape).copy()
    face = torch.from_numpy(position[fit.main])
    lay = partial(shares_of, fit, position, count, jitter)
    # A photograph shows own clothing by itself: no face is laid onto it.
    return Places(face, torch.from_numpy(at), torch.from_numpy(extent), lay, partial(SparseMap.empty, len(face), 0))


@dataclass(frozen=True, eq=False)
class PhotographView(BakedView):
    """A fitted person in a part of her photograph: a view whose base is the photograph beside what she wears."""

    fit: Fit = None
    kernels: tuple[Kernel, Kernel] = None
    """Down and across, of the whole image."""

    def beside(self, worn: SparseMap) -> BakedView:
        """See `BakedView`: what a pixel of the photograph wears hides that share of it."""
        device, (down, across) = self.pixels.device, self.kernels
        left = torch.ones(self.fit.person.shape, device=device)
        left.view(-1)[torch.from_numpy(self.fit.pixels).to(device)] -= worn.row_sums()
        base = photograph(self.fit.person.image, left, down, across, PADDING, self.pixels)
        own = {field.name: getattr(self, field.name) for field in fields(BakedView)}
        return BakedView(**own | {"base_color": base})

    @property
    def seen(self) -> Float32[Tensor, "P 3"]:
        """See `BakedView`: the photograph's pixels without the light that the fit takes them to have."""
        fit = self.fit
        colors = fit.person.image.reshape(-1, 3)[fit.pixels] / 255 / (fit.shading[:, None] * fit.tint)
        return torch.from_numpy(colors.astype(np.float32)).to(self.pixels.device)


def photograph_view(
    fit: Fit,
    position: Int64[np.ndarray, " T"],
    count: int,
    framing: Framing,
    jitter: FitJitter = EXACT,
    device: torch.device | str = "cpu",
) -> PhotographView:
    """View a fitted person whose clothes wear `count` faces (`logo_positions`)."""
    height, width = fit.person.shape
    down = Kernel.of(framing.y, framing.side, framing.size, height, framing.softness)
    across = Kernel.of(framing.x, framing.side, framing.size, width, framing.softness, framing.mirror)
    y, x = np.divmod(fit.pixels, width)
    tall, wide = ((int(at.min()), int(at.max()) + 1) for at in (y, x))
    # Only a rectangle of the image sees her; its pixels come first, so that the map ends with it.
    rows, columns = down.reached(*tall), across.reached(*wide)
    size = framing.size
    number = np.arange(size * size).reshape(size, size)
    worn = np.zeros((size, size), bool)
    worn[rows, columns] = True
    light = (fit.shading**jitter.folds * jitter.exposure).astype(np.float32)
    pixels = (y - tall[0]) * (wide[1] - wide[0]) + x - wide[0]
    parts = down.part(rows, *tall), across.part(columns, *wide)
    resampling = Resampling(torch.from_numpy(pixels), torch.from_numpy(light), *parts)

    def find_mask() -> Bool[Tensor, "s s"]:
        """Mark the pixels of the image that show the person by half or more."""
        mask = torch.from_numpy(fit.person.mask.astype(np.float32)).unsqueeze(2).expand(-1, -1, 3)
        return resample(mask, down, across)[:, :, 0] >= 0.5

    others = tuple(framing.box(box) for box in fit.person.others)
    subject = Subject(framing.box(fit.person.box), others, is_alone=False, find_mask=find_mask)
    view = PhotographView(
        height=size,
        width=size,
        pixels=torch.from_numpy(np.concatenate([number[worn], number[~worn]])),
        coverage=torch.ones(size * size),
        base_color=torch.zeros((), device=device).expand(3, size * size),
        front_count=resampling.height,
        map=resampling,
        places=places_of(fit, position, count, jitter),
        own=torch.zeros(0, 3),
        light_color=tuple(map(float, fit.tint)),
        subject=subject,
        fit=fit,
        kernels=(down, across),
    )
    return view.to(torch.device(device))
