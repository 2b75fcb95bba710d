"""Darknet's layers as torch modules. Each takes the previous output, then the earlier ones that its `sources` name.

The last are detection heads (`decoding.AnchorBoxes`).
"""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

# In place where the gradient needs only the result: every caller hands over a tensor nobody else reads.
ACTIVATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "linear": lambda x: x,
    "leaky": lambda x: F.leaky_relu_(x, 0.1),
    "relu": F.relu_,
    "relu6": F.relu6,
    "logistic": torch.sigmoid,
    "mish": F.mish,
    "swish": F.silu,
}


class BatchNorm(nn.BatchNorm2d):
    """Batch norm that divides by sqrt(var + 1e-5), or, with weights of the original Darknet, by sqrt(var) + 1e-6.

    The difference matters for dead channels: MobileNetV2-YOLOv3-Nano has three whose variance is 6e-45.
    """

    OUTSIDE = 1e-6

    def __init__(self, channels: int) -> None:
        super().__init__(channels, eps=1e-5)
        self.epsilon_outside = False
        """True: sqrt(var) + 1e-6, as the original Darknet's CPU code has it."""

    def forward(self, x: Tensor) -> Tensor:
        if self.training or not self.epsilon_outside:
            return super().forward(x)
        scale, shift = self.scale_and_shift()
        return x * scale.to(x.dtype)[:, None, None] + shift.to(x.dtype)[:, None, None]

    def scale_and_shift(self) -> tuple[Tensor, Tensor]:
        """Scale and shift [C] of each channel outside training, in float64."""
        variance = self.running_var.double()
        deviation = variance.sqrt() + self.OUTSIDE if self.epsilon_outside else (variance + self.eps).sqrt()
        scale = self.weight.double() / deviation
        return scale, self.bias.double() - self.running_mean.double() * scale


class Convolution(nn.Module):
    """[convolutional]: convolution, batch norm (unless folded or absent), activation."""

    def __init__(self, conv: nn.Conv2d, norm: BatchNorm | None, activation: str) -> None:
        super().__init__()
        self.conv, self.norm, self.activation = conv, norm, activation

    def forward(self, x: Tensor) -> Tensor:
        x = self.conv(x)
        if self.norm is not None:
            x = self.norm(x)
        return ACTIVATIONS[self.activation](x)

    @torch.no_grad()
    def fold(self) -> None:
        """Multiply the batch norm's running statistics into the convolution; afterwards it cannot train as before."""
        if self.norm is None:
            return
        scale, bias = self.norm.scale_and_shift()
        self.conv.weight.copy_(self.conv.weight.double() * scale[:, None, None, None])
        self.conv.bias = nn.Parameter(bias.to(self.conv.weight.dtype))
        self.norm = None


class MaxPool(nn.Module):
    """[maxpool]: size - 1 of padding, half of it on the left and top, the rest on the right and bottom."""

    def __init__(self, size: int, stride: int) -> None:
        super().__init__()
        self.size, self.stride = size, stride

    def out(self, length: int) -> int:
        return (length - 1) // self.stride + 1

    def forward(self, x: Tensor) -> Tensor:
        before = (self.size - 1) // 2
        after = [(self.out(n) - 1) * self.stride + self.size - n - before for n in x.shape[-2:]]
        if before == 0 and max(after) <= 0:
            return F.max_pool2d(x, self.size, self.stride)
        if before == after[0] == after[1]:
            return F.max_pool2d(x, self.size, self.stride, before)
        x = F.pad(x, (before, after[1], before, after[0]), value=float("-inf"))
        return F.max_pool2d(x, self.size, self.stride)


class Plain(nn.Module):
    """A layer without weights: a function of the previous output, or of the earlier ones that `sources` name."""

    def __init__(self, function: Callable[..., Tensor], sources: list[int] | None = None) -> None:
        super().__init__()
        self.function, self.sources = function, sources or []

    def forward(self, *tensors: Tensor) -> Tensor:
        return self.function(*tensors)


def match_channels(x: Tensor, channels: int) -> Tensor:
    """Drop channels, or add some of zeros."""
    extra = channels - x.shape[1]
    return F.pad(x, (0, 0, 0, 0, 0, extra)) if extra > 0 else x[:, :channels]


def reorg(x: Tensor, stride: int) -> Tensor:
    """Space to depth in Darknet's own order of elements.

    Darknet reads its input [C, H, W] as if it were [C/s², H*s, W*s], gathers s x s blocks into [C, H, W], and reads
    that as [C*s², H/s, W/s].
    """
    b, c, h, w = x.shape
    blocks = x.reshape(b, c // stride**2, h, stride, w, stride).permute(0, 3, 5, 1, 2, 4)
    return blocks.reshape(b, c * stride**2, h // stride, w // stride)
