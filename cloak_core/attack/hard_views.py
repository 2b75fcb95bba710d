"""Views that are still found are drawn more often.

A running mean of how surely a person is found is kept for every pose at every training azimuth. Every `EVERY` steps new
chances are worked out from it and hold for the next block of steps. They are made two steps before that block begins,
because a batch is built while the detector still works on the one before; so what a step draws depends on finished
steps alone, and a resumed run, or one in several processes, draws the same.
"""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

EVERY = 20
"""Steps that share their chances."""
MEMORY = 0.7
"""Weight of what was known of a view when it is seen again."""
LEAST = 0.02
"""Added to every view's mean, so that none is forgotten."""
_STATE = "hard_views."


class HardViews:
    """Chances of P poses x A azimuths."""

    def __init__(self, poses: int, azimuths: int) -> None:
        # Nothing known: as hard as can be, until it was seen.
        self._mean = np.ones((poses, azimuths))
        self._chances: dict[int, np.ndarray] = {}

    def draw(self, step: int, random: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Pose and azimuth index, [count] int64 each, of images of `step`."""
        azimuths = self._mean.shape[1]
        chances = self._chances.get(step // EVERY)
        total = np.ones(self._mean.size) if chances is None else chances.ravel()
        ladder = np.cumsum(total)
        cell = np.searchsorted(ladder, random.random(count) * ladder[-1], side="right")
        return np.divmod(np.minimum(cell, len(ladder) - 1), azimuths)

    def observe(
        self, step: int, pose: Int[np.ndarray, "B"], azimuth: Int[np.ndarray, "B"], found: Float[np.ndarray, "B"]
    ) -> None:
        """Note how surely a person was found, 0..1, in each image of `step`. In every process for the whole batch."""
        for p, a, value in zip(pose, azimuth, found, strict=True):
            self._mean[p, a] = MEMORY * self._mean[p, a] + (1 - MEMORY) * value
        if (step + 2) % EVERY == 0:
            block = (step + 2) // EVERY
            self._chances = {k: v for k, v in self._chances.items() if k == block - 1}
            self._chances[block] = self._mean + LEAST

    def state(self) -> dict[str, Tensor]:
        """Give the state for a checkpoint."""
        blocks = sorted(self._chances)
        kept = np.stack([self._chances[block] for block in blocks]) if blocks else np.empty((0, *self._mean.shape))
        return {
            _STATE + "mean": torch.from_numpy(self._mean.copy()),
            _STATE + "blocks": torch.tensor(blocks, dtype=torch.int64),
            _STATE + "chances": torch.from_numpy(kept),
        }

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state()`. KeyError or ValueError where the tensors belong to another run."""
        mean, blocks, chances = (tensors[_STATE + name].cpu().numpy() for name in ("mean", "blocks", "chances"))
        if mean.shape != self._mean.shape or chances.shape != (len(blocks), *mean.shape):
            raise ValueError("the hard views are those of other poses or angles")
        self._mean = mean.copy()
        self._chances = dict(zip(blocks.tolist(), chances.copy(), strict=True))
