"""Several detectors at once: which of them a step asks, and how their losses for an image become one."""

import numpy as np
from jaxtyping import Float

from cloak_core.core.settings.components import LossSettings
from cloak_core.core.technique import NO_TECHNIQUES, Techniques

_STREAM = 0xDE7
"""Of random numbers, apart from those that draw the images."""
_EVEN = 0.5
"""Share of the draws that go to all detectors alike where a technique weighs them: what is never asked is never known
better."""


class Ensemble:
    """The detectors of a run by their number, 0 .. count - 1."""

    def __init__(
        self, settings: LossSettings, count: int, seed: int = 0, techniques: Techniques = NO_TECHNIQUES
    ) -> None:
        self.count = count
        self.settings = settings
        self.seed = seed
        self.per_step = min(settings.detectors_per_step or count, count)
        self._weighing = next(iter(techniques.at("weights")), None)

    @property
    def is_subset(self) -> bool:
        """Whether a step asks only some of the detectors."""
        return self.per_step < self.count

    @property
    def weights(self) -> Float[np.ndarray, " detectors"]:
        """Each detector's weight now; they sum to 1.

        Where a technique weighs them, a subset asks more often instead, and weighs alike.
        """
        if self._weighing is None or self.is_subset:
            return np.full(self.count, 1.0) / self.count
        return self._weighing.weights()

    def asked(self, step: int | None) -> list[int]:
        """Choose the detectors of a step (None: all).

        A function of (seed, step) and of what was observed, so that a resumed run and every process ask the same.
        """
        chosen = np.arange(self.count)
        if step is not None and self.is_subset:
            random = np.random.default_rng([self.seed, _STREAM, step])
            often = None
            if self._weighing is not None:
                often = _EVEN / self.count + (1 - _EVEN) * self._weighing.weights()
            chosen = np.sort(random.choice(self.count, self.per_step, replace=False, p=often))
        return chosen.tolist()

    def weight(self, number: int, asked: int) -> float:
        """Compute what the loss of detector `number` counts, one of `asked`.

        Of a subset each detector counts for those left out, too, so that its expectation is the whole ensemble's.
        """
        return float(self.weights[number]) * self.count / asked
