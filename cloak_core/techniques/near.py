"""Colours that stay close to a garment's: a bound on the mean and on the 95th percentile of CIEDE2000, kept exactly.

The projection is that onto a ball of the summed distances (soft thresholding: Duchi et al., "Efficient projections onto
the l1-ball", ICML 2008), each face moving on the straight line to its garment's colour: most faces end as the garment
has them, and the difference is spent where it hides most.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from cloak_core.core.pattern import Pattern
from cloak_core.core.settings import TrainSettings
from cloak_core.core.technique import Technique
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.patterns.garments import garment_colors
from cloak_core.sources.bodies.logos.color_difference import de2000, lab
from cloak_core.zoo.entry import read_start

HALVINGS = 12
"""Of the way to the garment's colour, until a face is near enough."""


class Near(Technique):
    """A garment's colours, and how far from them all faces together may be."""

    def __init__(self, garment: Float[np.ndarray, "L 3"], mean: float, most: float) -> None:
        """garment: sRGB in [0, 1], float32; mean and most: the largest mean and 95th percentile of CIEDE2000."""
        self.garment = garment
        self.mean = mean
        self.most = most

    def distances(self, colors: Float[np.ndarray, "L 3"]) -> Float[np.ndarray, " L"]:
        """Compute each face's CIEDE2000 from the garment."""
        return de2000(lab(colors), lab(self.garment))

    def closeness(self, colors: Float[np.ndarray, "L 3"]) -> tuple[float, float]:
        """Compute mean and 95th percentile of CIEDE2000 from the garment."""
        far = self.distances(colors)
        return float(far.mean()), float(np.percentile(far, 95))

    def content(self) -> dict[str, object]:
        return {"near": {"sha256": sha256_arrays(self.garment)}}

    def report(self, colors: Float[np.ndarray, "L 3"]) -> dict[str, float]:
        return dict(zip(("de2000_mean", "de2000_p95"), self.closeness(colors), strict=True))

    def project(self, colors: Float[torch.Tensor, "L 3"]) -> Float[torch.Tensor, "L 3"]:
        """Move faces towards the garment until both bounds hold; colours that keep them stay to the bit.

        Faces of equal colours on equal garment colours stay equal.
        """
        own = colors.detach().cpu().numpy()
        far = self.distances(own)
        allowed = self._allowed(far)
        rows = np.flatnonzero(allowed < far)
        if not len(rows):
            return colors
        own = own.copy()
        own[rows] = self._moved(own[rows], self.garment[rows], allowed[rows])
        return torch.from_numpy(own).to(colors)

    def _allowed(self, far: Float[np.ndarray, " L"]) -> Float[np.ndarray, " L"]:
        """Find each face's largest distance so that both bounds hold together."""
        place = math.ceil(0.95 * (len(far) - 1))  # of the largest that the percentile looks at
        allowed = np.minimum(far, self.most) if np.sort(far)[place] > self.most else far
        if allowed is not far:
            # The few that a percentile does not see may stay; of equal ones all or none.
            allowed = np.where(far > np.sort(far)[place], far, allowed)
        if allowed.mean() <= self.mean:
            return allowed
        return np.maximum(allowed - _threshold(allowed, self.mean * len(allowed)), 0)

    def _moved(
        self, colors: Float[np.ndarray, "n 3"], garment: Float[np.ndarray, "n 3"], allowed: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n 3"]:
        """Find the farthest place on the line from the garment to each colour that is near enough."""
        low, high = np.zeros(len(colors)), np.ones(len(colors))
        base = lab(garment)
        reached = garment.copy()
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            tried = (garment + middle[:, None] * (colors - garment)).astype(np.float32)
            near = de2000(lab(tried), base) <= allowed
            reached[near] = tried[near]
            low, high = np.where(near, middle, low), np.where(near, high, middle)
        return reached


def read_garment(settings: TrainSettings, pattern: Pattern) -> Float[np.ndarray, "L 3"]:
    """Find the garment that colours stay close to; where faces share a colour, its mean there.

    InputError: no such garment; one of several colours where inks are counted.
    """
    named, most = settings.pattern.near, settings.pattern.colors_at_most
    garment = garment_colors(named, pattern.bodies, pattern.cover)
    garment = read_start(Path(named), pattern.cover, "--near") if garment is None else garment
    if most is not None and len(np.unique(garment, axis=0)) > 1:
        raise InputError("--near: with --colors-at-most the garment must have one colour")
    if most is not None and settings.objective.palette is not None:
        raise InputError("--near: would move colours away from those of --palette; give --colors-at-most alone")
    return pattern.from_faces(garment)


def _threshold(far: Float[np.ndarray, " L"], total: float) -> float:
    """Find what to take from every distance, none going below 0, so that they sum up to `total`."""
    ordered = np.sort(far)[::-1]
    sums = np.cumsum(ordered) - total
    counts = np.arange(1, len(far) + 1)
    last = np.flatnonzero(ordered > sums / counts)[-1]
    return float(sums[last] / counts[last])
