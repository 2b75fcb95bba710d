"""A few inks: each value ends as one of a few colours, learnt or chosen from a palette.

An assignment to a few inks that is made by rounding at the end throws away what training found. So it is made while
training goes on. At first colours are free; where inks are learnt, they then begin as the means of clusters of these.
From there on a colour is a mean of the inks, weighted by how near each is, and the temperature of these weights falls,
until for the last part of the run each patch has the nearest ink alone. Its gradient then is that of the colour itself,
as if nothing were assigned (a straight-through estimator: Bengio et al., arXiv 1308.3432), so that a patch may still
change its ink, and the inks, where they are learnt, their colour.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float

from cloak_core.core.technique import Technique

WARM, COLD = 0.2, 0.01
"""The temperature's ends, in squared units of colour."""
FREE_UNTIL, HARD_FROM = 0.25, 0.6
"""Shares of the run: before the one colours are free, after the other each patch has one ink."""


class Inks(Technique):
    """The colours there are: given ones, or learnt, or chosen among given ones, at most `most`."""

    is_exact = bars_search = True

    def __init__(self, most: int, fixed: Float[torch.Tensor, "P 3"] | None = None) -> None:
        self.most = most
        self.fixed = fixed
        self.rows = most if fixed is None or len(fixed) > most else 0
        """How many inks are free parameters."""
        self.progress = 0.0
        """How far the run is, 0 to 1: the temperature hangs on it."""

    def choose(
        self, values: Float[torch.Tensor, "N 3"], own: Float[torch.Tensor, "rows 3"], tone: Callable, is_final: bool
    ) -> Float[torch.Tensor, "N 3"]:
        cold = (self.progress - FREE_UNTIL) / (HARD_FROM - FREE_UNTIL)
        if cold < 0 and not is_final:
            return values
        temperature = None if is_final or cold >= 1 else WARM * (COLD / WARM) ** cold
        return assigned(values, self._inks(own, len(values), tone, temperature), temperature)

    def _inks(
        self, own: Float[torch.Tensor, "rows 3"], patches: int, tone: Callable, temperature: float | None
    ) -> Float[torch.Tensor, "K 3"]:
        if not self.rows:
            return self.fixed
        # An ink's gradient is the sum of its patches'; made their mean, it moves as they do under every optimiser.
        part = self.rows / patches
        inks = tone(part * own + (1 - part) * own.detach())
        return inks if self.fixed is None else assigned(inks, self.fixed, temperature)

    def reach(self, step: int, steps: int, values: Callable) -> Float[np.ndarray, "rows 3"] | None:
        """Begin inks that are learnt as means of clusters of the values; leave them where these are few."""
        self.progress = step / steps
        if not self.rows or step != math.ceil(FREE_UNTIL * steps):
            return None
        from scipy.cluster.vq import kmeans2

        own = values().detach().cpu().double().numpy()
        if len(np.unique(own, axis=0)) < self.rows:
            return None
        return kmeans2(own, self.rows, minit="++", seed=np.random.default_rng(0))[0]

    def first_rows(self, untone: Callable) -> Float[np.ndarray, "rows 3"]:
        """Choose inks far apart among all there may be, which a run that ends early has to go by."""
        if self.fixed is None:
            steps = np.linspace(0.1, 0.9, 5)
            candidates = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        else:
            candidates = untone(self.fixed.cpu().numpy())
        return far_apart(candidates, self.rows).astype(np.float32)


def assigned(
    values: Float[torch.Tensor, "N 3"], inks: Float[torch.Tensor, "K 3"], temperature: float | None
) -> Float[torch.Tensor, "N 3"]:
    """Mix each value from the inks, weighted by exp(-squared distance / temperature); None: take the nearest.

    The nearest one's gradient goes to that ink, and to the value as if it had stayed itself.
    """
    apart = ((values[:, None] - inks) ** 2).sum(dim=2)
    if temperature is not None:
        return torch.softmax(-apart / temperature, dim=1) @ inks
    # The difference is exactly 0, so that equal inks stay equal to the bit.
    return inks[apart.detach().argmin(dim=1)] + (values - values.detach())


def far_apart(colors: Float[np.ndarray, "P 3"], count: int) -> Float[np.ndarray, "K 3"]:
    """Choose `count` colours: the first, then repeatedly the one farthest from all chosen before."""
    chosen = [0]
    distance = ((colors - colors[0]) ** 2).sum(axis=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, ((colors - colors[chosen[-1]]) ** 2).sum(axis=1))
    return colors[chosen]
