"""Where a search by questions had better look: the gradients of detectors that the searcher does have.

The subspace attack (Yan, Guo and Zhang, NeurIPS 2019): random directions in thousands of colours hardly ever matter to
a detector; gradients of surrogates, shaken anew each time, span a space in which many of them do. The asked detector's
answers decide alone which of them is followed, and to which side.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from torch import Tensor

from cloak_core.attack.batches import Batch
from cloak_core.attack.objective import Objective
from cloak_core.files.errors import InputError

CELLS = (64, 1024)
"""Fewest and most cells over which a gradient is averaged: single faces' gradients are mostly of this one image."""


def random_cells(
    centres: Float[np.ndarray, "L 3"], bounds: tuple[int, int], random: np.random.Generator
) -> Int[np.ndarray, " L"]:
    """Divide the faces into cells around random faces: the number of each face's cell, from 0.

    Their number lies within `bounds`, drawn evenly in its logarithm.
    """
    low, high = np.log(np.minimum(bounds, len(centres)))
    count = round(np.exp(random.uniform(low, high)))
    about = centres[random.choice(len(centres), count, replace=False)]
    return cKDTree(about).query(centres)[1]


class QueryPrior:
    """Directions from surrogates' gradients. InputError: a surrogate gives none."""

    def __init__(self, objective: Objective, centres: Float[np.ndarray, "L 3"]) -> None:
        """Take the `objective` of the surrogates, the margin as its loss; centres: of the logo's faces, metres."""
        for detector in objective.detectors:
            if not detector.differentiable:
                raise InputError(f"--query-prior {detector.spec}: gives no gradients")
        self.objective, self.centres = objective, centres

    def directions(
        self, batch: Batch, colors: Float[Tensor, "L 3"], step: int, random: np.random.Generator
    ) -> Float[Tensor, "B L 3"]:
        """Give -1, 0 or 1 for every face and channel of each image: the sign of one surrogate's gradient.

        Averaged within cells; 0 where the image does not show the cell.
        """
        count = len(self.objective.detectors)
        gradient = self._gradient(batch, colors, step, random.integers(count, size=len(batch)))
        found = torch.empty_like(gradient)
        for row, one in zip(found, gradient, strict=True):
            cell = torch.from_numpy(random_cells(self.centres, CELLS, random)).to(one.device)
            sums = torch.zeros_like(one[: int(cell.max()) + 1])
            row.copy_(sums.index_add_(0, cell, one).sign()[cell])
        return found

    def _gradient(
        self, batch: Batch, colors: Float[Tensor, "L 3"], step: int, chosen: Int[np.ndarray, " B"]
    ) -> Float[Tensor, "B L 3"]:
        """Compute each image's gradient of its chosen surrogate's loss, by the colours in that image."""
        with torch.enable_grad():
            moved = colors.expand(len(batch), -1, -1).clone().requires_grad_()
            images, total = batch.images(moved), 0.0
            for number in np.unique(chosen).tolist():
                rows = torch.from_numpy(np.flatnonzero(chosen == number)).to(images.device)
                said = self.objective.detect(number, images[rows], step, batch.bodies[rows])
                total = total + self.objective.loss(said, number).sum()
            (gradient,) = torch.autograd.grad(total, moved)
        return gradient
