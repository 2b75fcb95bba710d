"""A detector behind a defence, and the defences that change the whole picture.

These are JPEG, blur, median, fewer bits, a random margin.
"""

import zlib

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from cloak_core.core.detector.protocol import Detections, Detector, state_hash
from cloak_core.core.distortions import blurred, through_jpeg, windowed
from cloak_core.detectors.defended.table import DEFENCES, read_head


def straight_through(images: Float[Tensor, "*shape"], value: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Give `value`, its gradient passed to `images` unchanged (straight-through estimator)."""
    return images + (value - images).detach()


class Defence(nn.Module):
    """Images [B, 3, H, W] in [0, 1] to images of the same shape; each by itself, and alike at every call."""

    partial_gradient = ""
    """What the gradient leaves out on purpose, in words; "" where it is exact."""

    def __init__(self, value: float) -> None:
        """value: its number, as `table.DEFENCES` says what that means."""
        super().__init__()
        self.value = value

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        raise NotImplementedError

    def placed(self, images: Float[Tensor, "B 3 H W"]) -> tuple[Float[Tensor, "B 3 H W"], Float[Tensor, "B 3"] | None]:
        """Give the images that the detector sees, and their windows (`filters.windowed`) where they were moved."""
        return self(images), None

    def detect(self, inner: Detector, images: Float[Tensor, "B 3 H W"]) -> Detections:
        """Ask the inner detector about the images behind the defence; boxes are in the pixels of the images given."""
        # A defence works on bytes of pictures, not on numbers of eight bits' precision.
        with torch.autocast(images.device.type, enabled=False):
            seen, windows = self.placed(images)
        found = inner(seen)
        if windows is None:
            return found
        size = found.boxes.new_tensor([images.shape[3], images.shape[2]] * 2)
        side, centre = windows[:, None, :1].to(found.boxes), windows[:, None, [1, 2, 1, 2]].to(found.boxes)
        return found._replace(boxes=(side * (2 * found.boxes / size - 1) + centre + 1) * size / 2)


class DefendedDetector(Detector):
    """Shows the inner detector what the defence leaves of the images; boxes are in the pixels of the images given.

    Where it reports, which class it looks for, the size it takes: all are the inner detector's.
    """

    def __init__(self, inner: Detector, name: str, value: float, spec: str) -> None:
        super().__init__(f"{name} {inner.name}", spec)
        self.defence, self.inner = DEFENCES[name].build(value), inner
        # A part of the state and of its hash, as whatever else decides the answers.
        self.register_buffer(f"{name.replace('-', '_')}_value", torch.tensor(value, dtype=torch.float64))
        self.differentiable, self.compiled = inner.differentiable, inner.compiled
        why = (self.defence.partial_gradient, inner.partial_gradient)
        self.partial_gradient = "; ".join(part for part in why if part)
        self.operating_point = inner.operating_point
        self.operating_point_assumed = inner.operating_point_assumed
        self.source = {"defence": name, "value": value}
        self.source |= {key: inner.source[key] for key in ("input_size", "layout") if key in inner.source}
        self.packages, self.class_names = inner.packages, inner.class_names
        if hasattr(inner, "person"):
            self.person = inner.person

    def look_again(self) -> dict[str, object]:
        """See `Detector.look_again`."""
        return {"inner": self.inner.whole_source()}

    def detect(self, images: Float[Tensor, "B 3 H W"]) -> Detections:
        return self.defence.detect(self.inner, images)

    def verify(self, before: str) -> None:
        """See `Detector.verify`; the inner detector verifies itself, too."""
        self.inner.verify(state_hash(self.inner))
        super().verify(before)


def defend(inner: Detector, head: str) -> DefendedDetector:
    """Put the defence that `head` names ("jpeg=75") before a detector; its tensors are shared.

    InputError: an unknown defence, a number out of bounds.
    """
    spec = f"{head}:{inner.spec}"
    name, value = read_head(head, spec)
    return DefendedDetector(inner, name, value, spec).to(inner.device).freeze()


class Jpeg(Defence):
    """Through JPEG of a quality in 1..100, as Dziugaite et al. (2016) proposed; without chroma subsampling."""

    partial_gradient = "JPEG's rounding is passed straight through"

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        with torch.no_grad():
            seen = through_jpeg(images, images.new_full((len(images),), self.value))
        return straight_through(images, seen)


class Blur(Defence):
    """A Gaussian blur, standard deviation in pixels."""

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        reach = max(1, min(round(3 * self.value + 0.5), min(images.shape[2:]) - 1))
        return blurred(images, images.new_full((len(images),), self.value), reach)


class Median(Defence):
    """The median of `side` x `side` pixels, channel by channel (Xu et al., "Feature squeezing", NDSS 2018)."""

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        (height, width), side = images.shape[2:], round(self.value)
        around = F.pad(images, (side // 2,) * 4, mode="replicate")
        if side == 3:
            return _median_of_nine(around)
        shifted = [around[:, :, y : y + height, x : x + width] for y in range(side) for x in range(side)]
        return torch.stack(shifted).median(dim=0).values


def _median_of_nine(around: Float[Tensor, "B C h w"]) -> Float[Tensor, "B C h-2 w-2"]:
    """Compute the 3 x 3 median by minima and maxima alone, eight times as fast.

    Columns are sorted once for all pixels that share them; the median is that of the largest minimum, the median median
    and the smallest maximum (Smith, "Implementing median filters in XC4000E FPGAs", Xcell 1996).
    """
    rows = [around[:, :, y : around.shape[2] - 2 + y] for y in range(3)]
    low, high = torch.minimum(rows[0], rows[1]), torch.maximum(rows[0], rows[1])
    sorted_columns = torch.minimum(low, rows[2]), _median_of_three(*rows), torch.maximum(high, rows[2])
    lows, middles, highs = ([part[..., x : part.shape[3] - 2 + x] for x in range(3)] for part in sorted_columns)
    largest = torch.maximum(torch.maximum(lows[0], lows[1]), lows[2])
    smallest = torch.minimum(torch.minimum(highs[0], highs[1]), highs[2])
    return _median_of_three(largest, _median_of_three(*middles), smallest)


def _median_of_three(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    return torch.maximum(torch.minimum(a, b), torch.minimum(torch.maximum(a, b), c))


class Bits(Defence):
    """So many bits of each channel, 1..8 (feature squeezing, too)."""

    partial_gradient = "rounding to a few levels is passed straight through"

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        levels = 2 ** round(self.value) - 1
        return straight_through(images, (images * levels).round() / levels)


class ResizePad(Defence):
    """Each image smaller by a random share up to `margin`, at a random place before mid-grey (Xie et al., ICLR 2018).

    The draw follows from the image's own bytes: whoever asks twice is told the same, in a batch of any size. The least
    change draws anew, so that a training, whose images change at every step, sees the expectation over all draws (EOT).
    """

    partial_gradient = "the random place is held fixed"

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        return self.placed(images)[0]

    def placed(self, images: Float[Tensor, "B 3 H W"]) -> tuple[Float[Tensor, "B 3 H W"], Float[Tensor, "B 3"]]:
        pixels = (images.detach() * 255).round().clamp(0, 255).to(torch.uint8).cpu().contiguous().numpy()
        windows = []
        for image in pixels:
            random = np.random.default_rng([zlib.crc32(image.tobytes()), 0x9AD])
            side = 1 / (1 - random.uniform(0, self.value))
            x, y = random.uniform(-1, 1, 2) * (side - 1)
            windows.append((side, float(x), float(y)))
        windows = torch.tensor(windows).to(images).view(-1, 3)
        return windowed(images, windows), windows
