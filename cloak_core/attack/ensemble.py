"""Several detectors at once: which of them a step asks, and how their losses for an image become one."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.attack.settings.loss import LossSettings
from cloak_core.files.errors import InputError

_STREAM = 0xDE7
"""Of random numbers, apart from those that draw the images."""


class Ensemble:
    """The detectors of a run by their number, 0 .. count - 1. InputError: weights or subsets that do not fit them."""

    def __init__(self, settings: LossSettings, count: int, seed: int = 0) -> None:
        self.count, self.settings, self.seed = count, settings, seed
        self.per_step = settings.detectors_per_step or count
        if self.per_step > count:
            raise InputError(f"--detectors-per-step: {self.per_step}, but the run has {count} --detector")
        weights = settings.detector_weights or (1.0,) * count
        if len(weights) != count:
            raise InputError(f"--detector-weights: {len(weights)} weights, but the run has {count} --detector")
        self.weights = [weight / sum(weights) for weight in weights]

    def asked(self, step: int | None) -> list[list[int]]:
        """The detectors of a step (None: all), in groups whose losses need each other: alone but for the maximum.

        A function of (seed, step), so that a resumed run and every process ask the same.
        """
        chosen = np.arange(self.count)
        if step is not None and self.per_step < self.count:
            random = np.random.default_rng([self.seed, _STREAM, step])
            chosen = np.sort(random.choice(self.count, self.per_step, replace=False))
        if self.settings.ensemble == "max":
            return [chosen.tolist()]
        return [[int(number)] for number in chosen]

    def combine(self, losses: dict[int, Float[Tensor, "B"]], asked: int) -> Float[Tensor, "B"]:
        """What a group adds to each image's loss, by the number of the detector; `asked` of them were in all groups.

        Of a subset each detector counts for those left out, too, so that its expectation is the whole ensemble's.
        """
        stacked = torch.stack(list(losses.values()))
        if self.settings.ensemble == "max":
            return stacked.amax(dim=0)
        weights = [self.weights[number] * self.count / asked for number in losses]
        return (stacked * stacked.new_tensor(weights)[:, None]).sum(dim=0)
