"""Several detectors at once: which of them a step asks, and how their losses for an image become one."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.settings.components import LossSettings
from cloak_core.files.errors import InputError

_STREAM = 0xDE7
"""Of random numbers, apart from those that draw the images."""
_MEMORY = 0.9
"""Weight of what was known of a detector when it is asked again."""
_SHARPNESS = 5.0
"""Of an adaptive ensemble: a detector that sees surely weighs e^5 as much as one that sees nothing."""
_EVEN = 0.5
"""Share of an adaptive ensemble's draws that go to all detectors alike: what is never asked is never known better."""
_STATE = "ensemble."


class Ensemble:
    """The detectors of a run by their number, 0 .. count - 1. InputError: weights that do not fit them."""

    def __init__(self, settings: LossSettings, count: int, seed: int = 0) -> None:
        self.count, self.settings, self.seed = count, settings, seed
        self.per_step = min(settings.detectors_per_step or count, count)
        weights = settings.detector_weights or (1.0,) * count
        if len(weights) != count:
            raise InputError(f"--detector-weights: {len(weights)} weights, but the run has {count} --detector")
        self._weights = np.array(weights) / sum(weights)
        # Nothing known: all see.
        self._levels = np.ones(count)

    @property
    def is_adaptive(self) -> bool:
        return self.settings.ensemble == "adaptive"

    @property
    def is_subset(self) -> bool:
        """Whether a step asks only some of the detectors."""
        return self.per_step < self.count

    @property
    def weights(self) -> Float[np.ndarray, " detectors"]:
        """Each detector's weight now; they sum to 1. An adaptive subset asks more often instead, and weighs alike."""
        if not self.is_adaptive or self.is_subset:
            return self._weights
        return self._standing()

    def _standing(self) -> Float[np.ndarray, " detectors"]:
        """Weigh detectors by how surely each found a person lately; the weights sum to 1."""
        grown = np.exp(_SHARPNESS * (self._levels - self._levels.max()))
        return grown / grown.sum()

    def observe(self, levels: dict[int, float]) -> None:
        """Note after a step how surely each detector found a person (`level`), by its number.

        From 0 over 0.5 at its own operating point to 1. In every process for the whole batch.
        """
        for number, level in levels.items():
            self._levels[number] = _MEMORY * self._levels[number] + (1 - _MEMORY) * level

    def state(self) -> dict[str, Tensor]:
        """Give the state for a checkpoint."""
        return {_STATE + "levels": torch.from_numpy(self._levels.copy())} if self.is_adaptive else {}

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state()`. KeyError or ValueError where the tensors belong to another run."""
        if not self.is_adaptive:
            return
        levels = tensors[_STATE + "levels"].cpu().numpy()
        if levels.shape != self._levels.shape:
            raise ValueError("the ensemble's state is that of other detectors")
        self._levels = levels.astype(np.float64, copy=True)

    def asked(self, step: int | None) -> list[list[int]]:
        """Choose the detectors of a step (None: all), in groups whose losses need each other: alone but for the
        maximum.

        A function of (seed, step) and of what was observed, so that a resumed run and every process ask the same.
        """
        chosen = np.arange(self.count)
        if step is not None and self.is_subset:
            random = np.random.default_rng([self.seed, _STREAM, step])
            often = _EVEN / self.count + (1 - _EVEN) * self._standing() if self.is_adaptive else None
            chosen = np.sort(random.choice(self.count, self.per_step, replace=False, p=often))
        if self.settings.ensemble == "max":
            return [chosen.tolist()]
        return [[int(number)] for number in chosen]

    def combine(self, losses: dict[int, Float[Tensor, "B"]], asked: int) -> Float[Tensor, "B"]:
        """Combine a group's losses, by the detector's number; `asked` detectors were in all groups.

        Of a subset each detector counts for those left out, too, so that its expectation is the whole ensemble's.
        """
        stacked = torch.stack(list(losses.values()))
        if self.settings.ensemble == "max":
            return stacked.amax(dim=0)
        weights = [float(self.weights[number]) * self.count / asked for number in losses]
        return (stacked * stacked.new_tensor(weights)[:, None]).sum(dim=0)


def level(scores: Float[Tensor, "B"], operating_point: float) -> Float[Tensor, "B"]:
    """Measure how surely a person is found beside the detector's operating point: 0.5 there, in [0, 1].

    The odds of the score over the sum of its odds and those of the operating point.
    """
    found = scores * (1 - operating_point)
    return found / (found + (1 - scores) * operating_point)
