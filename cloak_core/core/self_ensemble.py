"""Many networks out of one: a detector's residual branches and activations, shaken anew for every image of a step.

The self-ensemble of T-SEA (Huang et al., CVPR 2023), without touching the detector: while it runs, torch's functions
are looked at as they are called. Where two feature maps are added, the residual branch is multiplied by a random factor
or left out; what convolutions give is multiplied channel by channel. So it works on any network that torch runs step by
step (Darknet's shortcuts, torchvision's blocks, converted ONNX graphs, a user's own module), not on compiled ones.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from cloak_core.core.settings.components import SurrogateSettings

_STREAM = 0x5EA
"""Of random numbers, apart from those that draw the images."""
_ADDITIONS = ("add", "__add__", "__radd__", "__iadd__")
_READERS = ("conv2d", "batch_norm", "layer_norm", "group_norm")
"""What reads the input of a residual block first."""
_FEW_CHANNELS = 8
"""Maps with fewer are boxes and anchors being decoded, no features."""


class SelfEnsemble:
    """Makes a context for each detector and step in which the detector's network is another one."""

    def __init__(self, settings: SurrogateSettings, seed: int) -> None:
        self.settings, self.seed = settings, seed

    def shaken(self, number: int, step: int | None) -> contextlib.AbstractContextManager:
        """Shake detector `number` in `step`, by (seed, step, number); None, outside training, changes nothing."""
        if step is None or not self.settings.on:
            return contextlib.nullcontext()
        state = np.random.SeedSequence([self.seed, _STREAM, step, number]).generate_state(1, np.uint64)
        return _Shaking(self.settings, torch.Generator().manual_seed(int(state[0] >> 1)))


class _Shaking(TorchFunctionMode):
    """Changes what feature maps add up to, and what convolutions give."""

    def __init__(self, settings: SurrogateSettings, random: torch.Generator) -> None:
        super().__init__()
        self.settings, self.random = settings, random
        # By where they lie, for a slice of all channels is still the same map; the tensors themselves are kept so that
        # no other comes to lie there.
        self._read: dict[int, Tensor] = {}

    def __torch_function__(
        self, function: Callable, types: object, args: tuple = (), kwargs: dict | None = None
    ) -> object:
        name = getattr(function, "__name__", "")
        if name in _ADDITIONS and len(args) >= 2 and _are_maps(args[0], args[1]):
            args = (*self._branches(args[0], args[1]), *args[2:])
        found = function(*args, **(kwargs or {}))
        if name in _READERS and args and isinstance(args[0], Tensor):
            self._read[args[0].data_ptr()] = args[0]
        if name == "conv2d" and self.settings.activation_noise and isinstance(found, Tensor):
            found = found * self._factors(found, found.shape[1], self.settings.activation_noise)
        return found

    def _branches(self, one: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
        """Multiply the residual branch of two summands (or both, where neither is one).

        What a layer has read already is the way around; what none has read comes out of the branch.
        """
        is_way_around = [x.data_ptr() in self._read for x in (one, other)]
        is_residual = is_way_around[0] != is_way_around[1]
        changed = [
            x if is_residual and around else x * self._branch_factors(x, is_residual)
            for x, around in zip((one, other), is_way_around, strict=True)
        ]
        return changed[0], changed[1]

    def _branch_factors(self, x: Tensor, is_residual: bool) -> Tensor:
        factors = self._factors(x, 1, self.settings.shake)
        if is_residual and self.settings.random_depth:
            kept = torch.rand(len(x), generator=self.random) >= self.settings.random_depth
            factors = factors * kept.to(x.device, x.dtype).view(-1, 1, 1, 1)
        return factors

    def _factors(self, x: Tensor, channels: int, reach: float) -> Tensor:
        """Draw [B, channels, 1, 1], uniform in 1 ± reach."""
        drawn = torch.rand(len(x), channels, 1, 1, generator=self.random)
        return (1 + reach * (2 * drawn - 1)).to(x.device, x.dtype)


def _are_maps(one: object, other: object) -> bool:
    """Tell whether both are feature maps of one size."""
    if not (isinstance(one, Tensor) and isinstance(other, Tensor)):
        return False
    return one.dim() == 4 and one.shape == other.shape and one.shape[1] >= _FEW_CHANNELS and one.is_floating_point()
