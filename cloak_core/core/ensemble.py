"""Several detectors at once: which of them a step asks, and how their losses for an image become one."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.settings.components import LossSettings

_STREAM = 0xDE7
"""Of random numbers, apart from those that draw the images."""
_EVEN = 0.5
"""Share of an adaptive ensemble's draws that go to all detectors alike: what is never asked is never known better."""
_MEMORY = 0.9
"""Weight of what was known of a detector when it is asked again."""
_SHARPNESS = 5.0
"""A detector that sees surely weighs e^5 as much as one that sees nothing."""
_STATE = "ensemble.levels"


class Ensemble:
    """The detectors of a run by their number, 0 .. count - 1.

    An adaptive one weighs them by a softmax over a running mean of how surely each found a person.
    """

    def __init__(self, settings: LossSettings, count: int, seed: int = 0) -> None:
        self.count = count
        self.settings = settings
        self.seed = seed
        self.per_step = min(settings.detectors_per_step or count, count)
        self.is_adaptive = settings.ensemble == "adaptive"
        self._levels = np.ones(count)  # nothing known: all see

    @property
    def is_subset(self) -> bool:
        """Whether a step asks only some of the detectors."""
        return self.per_step < self.count

    @property
    def weights(self) -> Float[np.ndarray, " detectors"]:
        """Each detector's weight now; they sum to 1.

        Of an adaptive ensemble, a subset asks those more often instead that weigh more, and weighs alike.
        """
        return np.full(self.count, 1.0) / self.count if self.is_subset else self._sure_weights()

    def _sure_weights(self) -> Float[np.ndarray, " detectors"]:
        grown = np.exp(_SHARPNESS * (self._levels - self._levels.max()))
        return grown / grown.sum()

    def asked(self, step: int | None) -> list[int]:
        """Choose the detectors of a step (None: all).

        A function of (seed, step) and of what was observed, so that a resumed run and every process ask the same.
        """
        chosen = np.arange(self.count)
        if step is not None and self.is_subset:
            random = np.random.default_rng([self.seed, _STREAM, step])
            often = _EVEN / self.count + (1 - _EVEN) * self._sure_weights() if self.is_adaptive else None
            chosen = np.sort(random.choice(self.count, self.per_step, replace=False, p=often))
        return chosen.tolist()

    def weight(self, number: int, asked: int) -> float:
        """Compute what the loss of detector `number` counts, one of `asked`.

        Of a subset each detector counts for those left out, too, so that its expectation is the whole ensemble's.
        """
        return float(self.weights[number]) * self.count / asked

    def observe(self, levels: dict[int, float]) -> None:
        """Hear the mean `sureness` of each detector that was asked, by its number; in every process for all images."""
        for number, level in levels.items():
            self._levels[number] = _MEMORY * self._levels[number] + (1 - _MEMORY) * level

    def state(self) -> dict[str, Tensor]:
        """Give what an adaptive ensemble knows, for a checkpoint."""
        return {_STATE: torch.from_numpy(self._levels.copy())} if self.is_adaptive else {}

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state()`. KeyError or ValueError where it is that of other detectors."""
        if not self.is_adaptive:
            return
        levels = tensors[_STATE].cpu().numpy()
        if levels.shape != self._levels.shape:
            raise ValueError("the ensemble's state is that of other detectors")
        self._levels = levels.astype(np.float64, copy=True)


def sureness(scores: Float[Tensor, " B"], operating_point: float) -> Float[Tensor, " B"]:
    """Measure how surely a person is found beside the detector's operating point: 0.5 there, in [0, 1].

    The odds of the score over the sum of its odds and those of the operating point.
    """
    above = scores * (1 - operating_point)
    return above / (above + (1 - scores) * operating_point)
