"""A small network that says which pixels belong to a patch; `tools/pretrain/segmenter_training.py` made its weights."""

from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.torch import load
from torch import Tensor, nn

from cloak_core.files.errors import InputError
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
        x = self._shrunk(images) - 0.5
        levels = []
        for layer in self.down:
            x = layer(x)
            levels.append(x)
        x = self.context(x)
        for layer, finer in zip(self.up, levels[-2::-1], strict=True):
            x = layer(torch.cat([F.interpolate(x, finer.shape[2:], mode="nearest"), finer], 1))
        return self.last(x)

    @staticmethod
    def _shrunk(images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 3 h w"]:
        scale = SIDE / max(images.shape[2:])
        size = [max(STRIDE, round(n * scale / STRIDE) * STRIDE) for n in images.shape[2:]]
        return F.interpolate(images, size, mode="bilinear", align_corners=False, antialias=True)


def load_segmenter(path: Path = WEIGHTS) -> PatchSegmenter:
    """Load the trained network, in eval mode, without gradients of its own. InputError: no such file, or another's."""
    network = PatchSegmenter()
    try:
        network.load_state_dict(load(read_bytes(path)))
    except (SafetensorError, RuntimeError) as error:
        raise InputError(f"{path}: not the weights of a patch segmenter ({str(error).splitlines()[0]})") from None
    return network.eval().requires_grad_(False)


def _layer(before: int, after: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(before, after, 3, stride, dilation, dilation)
    return nn.Sequential(convolution, nn.LeakyReLU(0.1))
