"""ShakeDrop, a baseline: a detector's residual branches are scaled anew for every image of a step.

The self-ensemble of T-SEA (Huang et al., CVPR 2023), without touching the detector: while it runs, torch's functions
are looked at as they are called. Where two feature maps are added, the residual branch is multiplied by a random
factor. So it works on any network that torch runs step by step (Darknet's shortcuts, torchvision's blocks, converted
ONNX graphs, a user's own module), not on compiled ones.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch.overrides import TorchFunctionMode

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.settings import TrainSettings
from cloak_core.core.technique import Technique
from cloak_core.files.errors import InputError

_STREAM = 0x5EA
"""Of random numbers, apart from those that draw the images."""
_ADDITIONS = ("add", "__add__", "__radd__", "__iadd__")
_READERS = ("conv2d", "batch_norm", "layer_norm", "group_norm")
"""What reads the input of a residual block first."""
_FEW_CHANNELS = 8
"""Maps with fewer are boxes and anchors being decoded, no features."""


class Shake(Technique):
    """Makes a context for each detector and step in which the detector's network is another one."""

    def __init__(self, reach: float, seed: int) -> None:
        self.reach = reach
        self.seed = seed

    def detector_context(self, number: int, step: int) -> contextlib.AbstractContextManager:
        """Shake detector `number` in `step`, by (seed, step, number)."""
        state = np.random.SeedSequence([self.seed, _STREAM, step, number]).generate_state(1, np.uint64)
        return _Shaking(self.reach, torch.Generator().manual_seed(int(state[0] >> 1)))


class _Shaking(TorchFunctionMode):
    """Changes what feature maps add up to while the block runs."""

    def __init__(self, reach: float, random: torch.Generator) -> None:
        super().__init__()
        self.reach = reach
        self.random = random
        # By where they lie, for a slice of all channels is still the same map; the tensors themselves are kept so that
        # no other comes to lie there.
        self._read: dict[int, torch.Tensor] = {}

    def __torch_function__(
        self, function: Callable, types: object, args: tuple = (), kwargs: dict | None = None
    ) -> object:
        """Call a function of torch, its summands changed."""
        name = getattr(function, "__name__", "")
        if name in _ADDITIONS and len(args) >= 2 and _are_maps(args[0], args[1]):
            args = (*self._branches(args[0], args[1]), *args[2:])
        result = function(*args, **(kwargs or {}))
        if name in _READERS and args and isinstance(args[0], torch.Tensor):
            self._read[args[0].data_ptr()] = args[0]
        return result

    def _branches(self, one: torch.Tensor, other: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Multiply the residual branch of two summands (or both, where neither is one).

        What a layer has read already is the way around; what none has read comes out of the branch.
        """
        is_way_around = [x.data_ptr() in self._read for x in (one, other)]
        is_residual = is_way_around[0] != is_way_around[1]
        changed = []
        for x, around in zip((one, other), is_way_around, strict=True):
            if not (is_residual and around):
                drawn = torch.rand(len(x), 1, 1, 1, generator=self.random)
                x = x * (1 + self.reach * (2 * drawn - 1)).to(x.device, x.dtype)  # an image's factor is in 1 ± reach
            changed.append(x)
        return changed[0], changed[1]


def _are_maps(one: object, other: object) -> bool:
    """Tell whether both are feature maps of one size."""
    if not (isinstance(one, torch.Tensor) and isinstance(other, torch.Tensor)):
        return False
    return one.dim() == 4 and one.shape == other.shape and one.shape[1] >= _FEW_CHANNELS and one.is_floating_point()


def build(settings: TrainSettings, pattern: object, detectors: Sequence[Detector], device: object) -> Shake:
    """Build the technique. InputError: a detector is compiled."""
    for detector in detectors:
        if detector.compiled:
            raise InputError(f"--detector {detector.spec}: compiled, so --shake does not reach into it")
    return Shake(settings.surrogates.shake, settings.run.seed)
