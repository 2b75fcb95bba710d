"""An adaptive ensemble: the detector that still finds the person most surely counts most, or is asked most often."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from cloak_core.core.technique import Setup, Technique
from cloak_core.files.lazy import Lazy

torch = Lazy("torch")
_MEMORY = 0.9
"""Weight of what was known of a detector when it is asked again."""
_SHARPNESS = 5.0
"""A detector that sees surely weighs e^5 as much as one that sees nothing."""
_STATE = "ensemble.levels"


class Adaptive(Technique):
    """Weighs detectors by a softmax over a running mean of how surely each found a person."""

    group = "objective"
    choice = ("ensemble", "adaptive")

    def __init__(self, count: int) -> None:
        # Nothing known: all see.
        self._levels = np.ones(count)

    @classmethod
    def build(cls, setup: Setup) -> Adaptive | None:
        return cls(len(setup.detectors)) if setup.settings.objective.ensemble == cls.choice[1] else None

    def weights(self) -> Float[np.ndarray, " detectors"]:
        grown = np.exp(_SHARPNESS * (self._levels - self._levels.max()))
        return grown / grown.sum()

    def level(self, scores: Float[torch.Tensor, " B"], operating_point: float) -> Float[torch.Tensor, " B"]:
        """Measure how surely a person is found beside the detector's operating point: 0.5 there, in [0, 1].

        The odds of the score over the sum of its odds and those of the operating point.
        """
        above = scores * (1 - operating_point)
        return above / (above + (1 - scores) * operating_point)

    def observe(self, levels: dict[int, float]) -> None:
        for number, level in levels.items():
            self._levels[number] = _MEMORY * self._levels[number] + (1 - _MEMORY) * level

    def state(self) -> dict[str, torch.Tensor]:
        return {_STATE: torch.from_numpy(self._levels.copy())}

    def load(self, tensors: dict[str, torch.Tensor]) -> None:
        levels = tensors[_STATE].cpu().numpy()
        if levels.shape != self._levels.shape:
            raise ValueError("the ensemble's state is that of other detectors")
        self._levels = levels.astype(np.float64, copy=True)


TECHNIQUE = Adaptive
