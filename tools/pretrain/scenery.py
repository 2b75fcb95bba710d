"""Places without people for training: heavy random crops of photographs and procedural scenes."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageChops

from cloak_core.sources.backdrops.backgrounds import Backgrounds

PHOTO_SIDE = 832
SCENE_SIDE = 320
Rng = np.random.Generator
_FILTERS = (Image.Resampling.BOX, Image.Resampling.BILINEAR, Image.Resampling.BICUBIC, Image.Resampling.LANCZOS)


class Scenery:
    """Draws crops, `photo_share` of them from photographs: mirrored, some blended or with their channels shuffled."""

    def __init__(self, procedural: Backgrounds, photos: Backgrounds | None = None, photo_share: float = 0.65) -> None:
        self.procedural = _images(procedural, SCENE_SIDE)
        self.photos = _images(photos, PHOTO_SIDE) if photos is not None else []
        self.photo_share = photo_share if self.photos else 0.0

    def draw(self, rng: Rng, size: int) -> UInt8[np.ndarray, "S S 3"]:
        """One square crop."""
        image = self._crop(rng, size)
        if rng.random() < 0.12:
            image = Image.blend(image, self._crop(rng, size), rng.uniform(0.2, 0.8))
        if rng.random() < 0.25:
            bands = list(image.split())
            rng.shuffle(bands)
            bands = [ImageChops.invert(b) if rng.random() < 0.1 else b for b in bands]
            image = Image.merge("RGB", bands)
        return np.asarray(image)

    def _crop(self, rng: Rng, size: int) -> Image.Image:
        if rng.random() < self.photo_share:
            (image, half), smallest = self.photos[rng.integers(len(self.photos))], 0.15
        else:
            (image, half), smallest = self.procedural[rng.integers(len(self.procedural))], 0.4
        short = min(image.size)
        whole = rng.random() < 0.2
        width, height = (1.0, 1.0) if whole else rng.uniform(smallest, 1.0) * np.exp(rng.uniform(-0.3, 0.3, 2))
        width, height = (short * np.array([width, height])).clip(8, image.size)
        x, y = rng.uniform(0, image.width - width), rng.uniform(0, image.height - height)
        box = np.array([x, y, x + width, y + height])
        if min(width, height) > 2 * size:  # an already halved copy is faster to shrink
            image, box = half, box / 2
        crop = image.resize((size, size), _FILTERS[rng.integers(4)], box=tuple(box.tolist()))
        return crop.transpose(Image.Transpose.FLIP_LEFT_RIGHT) if rng.random() < 0.5 else crop


def _images(backgrounds: Backgrounds, side: int) -> list[tuple[Image.Image, Image.Image]]:
    """Each image and its half-size copy."""
    each = (backgrounds.image(i, (side, side)) for i in range(len(backgrounds)))
    images = [Image.fromarray(np.ascontiguousarray(image.permute(1, 2, 0).numpy())) for image in each]
    return [(image, image.reduce(2)) for image in images]
