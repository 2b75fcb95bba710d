"""What cameras do to images, differentiably: crop, margin, blur."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.filters import blurred, windowed


@dataclass(frozen=True)
class Distortion:
    """What happens to B images after they were composed; None: nothing of that kind."""

    window: Float[Tensor, "B 3"] | None = None
    """Side and centre (x, y) of what is shown, in units in which the image's edges are at -1 and 1."""
    blur: Float[Tensor, "B"] | None = None
    """Standard deviations of a Gaussian, pixels."""

    def __call__(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        if self.window is not None:
            images = windowed(images, self.window)
        if self.blur is not None:
            images = blurred(images, self.blur)
        return images

    def boxes(self, boxes: Float[Tensor, "B 4"], height: int, width: int) -> Float[Tensor, "B 4"]:
        """Move boxes (xyxy, pixels) with the images of this size, and clip them to what is still shown."""
        size = boxes.new_tensor([width, height] * 2)
        at = 2 * boxes / size - 1
        if self.window is not None:
            at = (at - self.window[:, [1, 2, 1, 2]]) / self.window[:, :1]
        return torch.minimum(((at + 1) * size / 2).clamp(min=0), size)


def draw_window(random: np.random.Generator, crop: float, pad: float) -> tuple[float, float, float]:
    """Draw one image's window (see `Distortion`): up to a share `crop` cut away, or up to `pad` of margin."""
    is_crop = random.random() < 0.5 if crop and pad else bool(crop)
    share = random.uniform(0, crop if is_crop else pad)
    side = 1 - share if is_crop else 1 / (1 - share)
    x, y = random.uniform(-1, 1, 2) * abs(1 - side)
    return side, x, y
