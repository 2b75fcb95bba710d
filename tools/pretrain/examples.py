"""Training images: people in random clothes composed over places, with their true boxes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from tools.pretrain.outfits import Wardrobe
from tools.pretrain.people import IMAGE, CroppedView
from tools.pretrain.scenery import Scenery

MAX_PEOPLE = 4
PEOPLE_SHARES = (0.25, 0.48, 0.17, 0.06, 0.04)
"""How many images show no, one, two ... people."""
WANTED, IGNORED = 0.4, 0.1
"""A person of whom this share is visible must be found; between the two, either answer is right."""
Rng = np.random.Generator


class Batch(NamedTuple):
    """Images with true boxes (xyxy, fractions of the image), at most four each."""

    images: Float[Tensor, "B 3 S S"]
    boxes: Float[Tensor, "B 4 4"]
    present: Bool[Tensor, "B 4"]
    ignored: Bool[Tensor, "B 4"]


class Example(NamedTuple):
    """One image; rows beyond the people it shows are neither present nor ignored."""

    image: Float[Tensor, "3 S S"]
    boxes: Float[Tensor, "4 4"]
    present: Bool[Tensor, 4]
    ignored: Bool[Tensor, 4]


class ExampleMaker:
    """Composes examples of one size from cropped views, outfits and scenery."""

    def __init__(self, views: list[CroppedView], wardrobe: Wardrobe, scenery: Scenery, size: int) -> None:
        self.views, self.wardrobe, self.scenery, self.size = views, wardrobe, scenery, size

    def batch(self, rng: Rng, count: int, hard: list[Tensor] | None = None) -> Batch:
        """`count` augmented examples, the last of them the uint8 images of places in `hard`."""
        hard = hard or []
        people = rng.choice(MAX_PEOPLE + 1, count - len(hard), p=PEOPLE_SHARES)
        examples = [self.example(rng, int(n)) for n in people] + [_empty(image.float() / 255) for image in hard]
        images, boxes, present, ignored = (torch.stack(group) for group in zip(*examples, strict=True))
        return Batch(augment(rng, images), boxes, present, ignored)

    def place(self, rng: Rng) -> Tensor:
        """A place without people: uint8 [3, S, S]."""
        return torch.from_numpy(self.scenery.draw(rng, self.size).transpose(2, 0, 1).copy())

    def example(self, rng: Rng, people: int, plain: bool = False) -> Example:
        """An image with so many people, far ones first; `plain` keeps them at the size and height they were seen."""
        empty = _empty(self.place(rng).float() / 255)
        image, boxes, present, ignored = empty
        views = sorted((self.views[i] for i in rng.integers(len(self.views), size=people)), key=lambda v: -v.distance)
        masks: list[Tensor] = []
        whole: list[float] = []
        for i, view in enumerate(views):
            mask, total = self._paste(rng, image, view, plain)
            masks = [m * (1 - mask) for m in masks] + [mask]
            whole.append(total)
            boxes[i] = _box(mask)
        for i, (mask, total) in enumerate(zip(masks, whole, strict=True)):
            share = float(mask.sum()) / max(total, 1.0)
            seen = float(boxes[i, 2] - boxes[i, 0]) * float(boxes[i, 3] - boxes[i, 1]) > 0
            present[i] = seen and share >= WANTED
            ignored[i] = seen and IGNORED <= share < WANTED
        return empty

    def _paste(self, rng: Rng, image: Tensor, view: CroppedView, plain: bool) -> tuple[Float[Tensor, "S S"], float]:
        """Paint one person; returns its coverage of the image, and its whole coverage were the image endless."""
        patch = view.dress(torch.from_numpy(np.ascontiguousarray(self.wardrobe.draw(rng))))
        scale, stretch = self.size / IMAGE, 1.0
        x, y = (view.origin[0] + view.width / 2) * scale, (view.origin[1] + view.height / 2) * scale
        if plain:
            x, y = x + rng.uniform(-50, 50) * scale, y + rng.uniform(-50, 50) * scale
        else:
            scale *= math.exp(rng.uniform(-0.25, 0.2))
            stretch = math.exp(rng.uniform(-0.12, 0.12))
            tone = rng.uniform(0.7, 1.2)
            patch[:3] = (patch[:3] * tone).clamp(max=1)
            if rng.random() < 0.5:
                x, y = rng.uniform(-0.5, 0.5) * self.size, rng.uniform(-0.4, 0.4) * self.size
            else:
                x, y = x + rng.normal(0, 0.15) * self.size, y + rng.normal(0, 0.1) * self.size
        if rng.random() < 0.5:
            patch = patch.flip(-1)
        height, width = max(4, round(view.height * scale)), max(3, round(view.width * scale * stretch))
        smooth = bool(rng.random() < 0.5)
        patch = F.interpolate(patch[None], (height, width), mode="bilinear", antialias=smooth)[0]
        left, top = round(self.size / 2 + x - width / 2), round(self.size / 2 + y - height / 2)
        mask = image.new_zeros(image.shape[1:])
        x0, y0, x1, y1 = max(0, left), max(0, top), min(self.size, left + width), min(self.size, top + height)
        if x1 > x0 and y1 > y0:
            part = patch[:, y0 - top : y1 - top, x0 - left : x1 - left]
            mask[y0:y1, x0:x1] = part[3]
            image[:, y0:y1, x0:x1].mul_(1 - part[3]).add_(part[:3])
        return mask, float(patch[3].sum())


def augment(rng: Rng, images: Float[Tensor, "B 3 S S"]) -> Float[Tensor, "B 3 S S"]:
    """Exposure, contrast, tint, softness and noise; a quarter of the images stay as they are."""
    count = len(images)
    changed = rng.random(count) < 0.75
    gain = np.exp(rng.normal(0, 0.2, (count, 1))) * np.exp(rng.normal(0, 0.07, (count, 3)))
    lift = rng.normal(0, 0.06, (count, 1)) + 0.5 * (1 - np.exp(rng.normal(0, 0.2, (count, 1))))
    gain, lift = np.where(changed[:, None], gain, 1), np.where(changed[:, None], lift, 0)
    images = images * _column(gain) + _column(lift)
    soft = np.flatnonzero(changed & (rng.random(count) < 0.2)).tolist()
    if soft:
        images[soft] = F.avg_pool2d(F.pad(images[soft], (1, 1, 1, 1), mode="replicate"), 3, 1)
    noisy = np.flatnonzero(changed & (rng.random(count) < 0.35)).tolist()
    if noisy:
        generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
        amplitude = torch.from_numpy(rng.uniform(0, 0.08, len(noisy))).float()[:, None, None, None]
        noise = torch.randn((len(noisy), *images.shape[1:]), generator=generator)
        images[noisy] += amplitude * noise
    return images.clamp_(0, 1)


def _column(values: np.ndarray) -> Tensor:
    return torch.from_numpy(values).float()[:, :, None, None]


def _empty(image: Tensor) -> Example:
    nobody = torch.zeros(MAX_PEOPLE, dtype=torch.bool)
    return Example(image, torch.zeros(MAX_PEOPLE, 4), nobody, nobody.clone())


def _box(mask: Float[Tensor, "S S"]) -> Float[Tensor, 4]:
    """The box (xyxy, fractions) of the pixels at least half covered; zeros where there are none."""
    height, width = mask.shape
    solid = mask >= 0.5
    rows, columns = solid.any(1).nonzero()[:, 0], solid.any(0).nonzero()[:, 0]
    if not len(rows):
        return torch.zeros(4)
    edges = [columns[0] / width, rows[0] / height, (columns[-1] + 1) / width, (rows[-1] + 1) / height]
    return torch.stack(edges)
