"""Defences that look for a patch, and paint over it what stands around."""

import math
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.torch import load
from torch import Tensor, nn

from cloak_core.detectors.defended.detector import Defence, straight_through
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.reading import read_bytes

WEIGHTS = Path(__file__).with_name("segmenter.safetensors")
SIDE = 208
"""Images are shown to it with their longer side this long, in pixels."""
STRIDE = 8


class PatchSegmenter(nn.Module):
    """Images [B, 3, H, W] in [0, 1] -> logits of a patch [B, 1, h, w], coarser than the images."""

    def __init__(self, width: int = 12) -> None:
        super().__init__()
        self.down = nn.ModuleList([_layer(3, width, 2), _layer(width, 2 * width, 2), _layer(2 * width, 4 * width, 2)])
        self.context = nn.Sequential(_layer(4 * width, 4 * width, 1, 2), _layer(4 * width, 4 * width, 1, 4))
        self.up = nn.ModuleList([_layer(6 * width, 2 * width), _layer(3 * width, width)])
        self.last = nn.Conv2d(width, 1, 1)

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 1 h w"]:
        scale = SIDE / max(images.shape[2:])
        size = [max(STRIDE, round(n * scale / STRIDE) * STRIDE) for n in images.shape[2:]]
        x = F.interpolate(images, size, mode="bilinear", align_corners=False, antialias=True) - 0.5
        levels = []
        for layer in self.down:
            x = layer(x)
            levels.append(x)
        x = self.context(x)
        for layer, finer in zip(self.up, levels[-2::-1], strict=True):
            x = layer(torch.cat([F.interpolate(x, finer.shape[2:], mode="nearest"), finer], 1))
        return self.last(x)


def load_segmenter(path: Path = WEIGHTS) -> PatchSegmenter:
    """Load the trained network, in eval mode, without gradients of its own. InputError: no such file, or another's."""
    network = PatchSegmenter()
    try:
        network.load_state_dict(load(read_bytes(path)))
    except (SafetensorError, RuntimeError) as error:
        raise InputError(f"{path}: not the weights of a patch segmenter ({first_line(error)})") from None
    return network.eval().requires_grad_(False)


def _layer(before: int, after: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(before, after, 3, stride, dilation, dilation)
    return nn.Sequential(convolution, nn.LeakyReLU(0.1))


BLOCK = 8
"""Side of the squares, in pixels, that an entropy mask decides on; it looks at three by three of them."""
LEVELS = 16
"""Of brightness that the local histogram tells apart: at most log2(16) = 4 bits."""
SOFTNESS = 0.1
"""Width of the soft decision that the gradient sees, in bits."""
_AROUND = 9
"""Squares across, of which the mean is painted over a patch."""


class Masking(Defence):
    """Paints over all that `evidence` finds to be a patch.

    The detector sees the hard decision. The gradient is that of the pixels as if they were not painted over, plus that
    of the soft decision (both are needed to attack it: to hide from the detector, and from the mask).
    """

    partial_gradient = "the decision what is painted over is soft in the gradient alone"

    def evidence(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 1 H W"]:
        """Estimate how likely each pixel belongs to a patch: masked above 0.5; differentiable."""
        raise NotImplementedError

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 H W"]:
        soft = self.evidence(images)
        with torch.no_grad():
            hard = (soft > 0.5).to(images.dtype)
            fill = surroundings(images, hard)
            seen = torch.lerp(images, fill, hard)
        return straight_through(images + (fill - images.detach()) * soft, seen)


class EntropyMask(Masking):
    """Paints over whatever is too rich to be natural: local entropy above `bits`.

    After Jedi (Tarchoun et al., CVPR 2023), with a majority of neighbours in place of its autoencoder, one threshold
    instead of one for each image, and the surroundings' mean in place of inpainting.
    """

    def evidence(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 1 H W"]:
        soft = torch.sigmoid((local_entropy(images) - self.value) / SOFTNESS)
        # A square alone is no patch: the mean over its neighbourhood decides.
        soft = F.avg_pool2d(soft, 3, 1, 1, count_include_pad=False)
        large = F.interpolate(soft, scale_factor=float(BLOCK), mode="nearest")
        return large[:, :, : images.shape[2], : images.shape[3]]


class SegmenterMask(Masking):
    """Paints over what a small network takes for a patch with at least this probability.

    After SAC (Liu et al., CVPR 2022) and PAD (Jing et al., CVPR 2024), without their completion of shapes; the network
    is our own, trained by `tools/pretrain/segmenter_training.py` on renders alone.
    """

    def __init__(self, probability: float) -> None:
        super().__init__(probability)
        self.network, self.shift = load_segmenter(), math.log(probability / (1 - probability))

    def evidence(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 1 H W"]:
        logits = F.interpolate(self.network(images), images.shape[2:], mode="bilinear", align_corners=False)
        return torch.sigmoid(logits - self.shift)


def local_entropy(images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 1 rows columns"]:
    """Compute entropy in bits of each channel's histogram around each square of `BLOCK` pixels, mean over the channels.

    A brightness counts for the two levels it lies between, so that it has a gradient.
    """
    height, width = images.shape[2:]
    padded = F.pad(images, (0, -width % BLOCK, 0, -height % BLOCK), mode="replicate")
    counts = []
    for level in range(LEVELS):
        share = (1 - (padded * (LEVELS - 1) - level).abs()).clamp(min=0)
        counts.append(F.avg_pool2d(share, BLOCK))
    histogram = torch.stack(counts, 1).flatten(1, 2)
    histogram = F.avg_pool2d(histogram, 3, 1, 1, count_include_pad=False).unflatten(1, (LEVELS, 3))
    bits = -(histogram * torch.log2(histogram.clamp(min=1e-6))).sum(1)
    return bits.mean(1, keepdim=True)


def surroundings(images: Float[Tensor, "B 3 H W"], mask: Float[Tensor, "B 1 H W"]) -> Float[Tensor, "B 3 H W"]:
    """Average what is not masked around each pixel; the whole image where nothing near is left."""
    kept = 1 - mask
    small, share = (F.avg_pool2d(part, BLOCK, ceil_mode=True) for part in (images * kept, kept))
    whole = small.mean((2, 3), keepdim=True) / share.mean((2, 3), keepdim=True).clamp(min=1e-6)
    near, known = (F.avg_pool2d(part, _AROUND, 1, _AROUND // 2) for part in (small, share))
    mean = torch.where(known > 1e-3, near / known.clamp(min=1e-3), whole)
    return F.interpolate(mean, images.shape[2:], mode="bilinear", align_corners=False)
