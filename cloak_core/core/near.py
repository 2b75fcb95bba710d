"""Colours that stay close to a garment's: a bound on the mean and on the 95th percentile of CIEDE2000, kept exactly.

The projection is that onto a ball of the summed distances (soft thresholding: Duchi et al., "Efficient projections onto
the l1-ball", ICML 2008), each face moving on the straight line to its garment's colour: most faces end as the garment
has them, and the difference is spent where it hides most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.sources.bodies.logos.color_difference import de2000, lab

HALVINGS = 12
"""Of the way to the garment's colour, until a face is near enough."""


@dataclass(frozen=True, eq=False)
class Near:
    """A garment's colours, and how far from them all faces together may be."""

    garment: Float[np.ndarray, "L 3"]
    """sRGB in [0, 1], float32."""
    mean: float
    """The largest mean of CIEDE2000 over the faces."""
    most: float
    """The largest 95th percentile."""

    def distances(self, colors: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, " L"]:
        """Compute each face's CIEDE2000 from the garment."""
        return de2000(lab(colors), lab(self.garment))

    def closeness(self, colors: Float[np.ndarray, "L 3"]) -> tuple[float, float]:
        """Compute mean and 95th percentile of CIEDE2000 from the garment."""
        far = self.distances(colors)
        return float(far.mean()), float(np.percentile(far, 95))

    @torch.no_grad()
    def project(self, colors: Float[Tensor, "L 3"]) -> Float[Tensor, "L 3"]:
        """Move faces towards the garment until both bounds hold; colours that keep them stay to the bit.

        Faces of equal colours on equal garment colours stay equal.
        """
        own = colors.detach().cpu().numpy()
        far = self.distances(own)
        wanted = self._wanted(far)
        rows = np.flatnonzero(wanted < far)
        if not len(rows):
            return colors
        own = own.copy()
        own[rows] = self._moved(own[rows], self.garment[rows], wanted[rows])
        return torch.from_numpy(own).to(colors)

    def _wanted(self, far: Float[np.ndarray, " L"]) -> Float[np.ndarray, " L"]:
        """Find each face's largest distance so that both bounds hold together."""
        place = math.ceil(0.95 * (len(far) - 1))  # of the largest that the percentile looks at
        wanted = np.minimum(far, self.most) if np.sort(far)[place] > self.most else far
        if wanted is not far:
            # The few that a percentile does not see may stay; of equal ones all or none.
            wanted = np.where(far > np.sort(far)[place], far, wanted)
        if wanted.mean() <= self.mean:
            return wanted
        return np.maximum(wanted - _threshold(wanted, self.mean * len(wanted)), 0)

    def _moved(
        self, colors: Float[np.ndarray, "n 3"], garment: Float[np.ndarray, "n 3"], wanted: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n 3"]:
        """Find the farthest place on the line from the garment to each colour that is near enough."""
        low, high = np.zeros(len(colors)), np.ones(len(colors))
        base = lab(garment)
        reached = garment.copy()
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            tried = (garment + middle[:, None] * (colors - garment)).astype(np.float32)
            near = de2000(lab(tried), base) <= wanted
            reached[near] = tried[near]
            low, high = np.where(near, middle, low), np.where(near, high, middle)
        return reached


def _threshold(far: Float[np.ndarray, " L"], total: float) -> float:
    """Find what to take from every distance, none going below 0, so that they sum up to `total`."""
    ordered = np.sort(far)[::-1]
    sums = np.cumsum(ordered) - total
    counts = np.arange(1, len(far) + 1)
    last = np.flatnonzero(ordered > sums / counts)[-1]
    return float(sums[last] / counts[last])
