"""From free parameters to the colours of faces: patches, averaging, a printer's profile, and a few inks.

An assignment to a few inks that is made by rounding at the end throws away what training found. So it is made while
training goes on. At first colours are free; where inks are learnt, they then begin as the means of clusters of these.
From there on a colour is a mean of the inks, weighted by how near each is, and the temperature of these weights falls,
until for the last part of the run each patch has the nearest ink alone. Its gradient then is that of the colour itself,
as if nothing were assigned (a straight-through estimator: Bengio et al., arXiv 1308.3432), so that a patch may still
change its ink, and the inks, where they are learnt, their colour.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from scipy.cluster.vq import kmeans2
from torch import Tensor

from cloak_core.core.visibility.sparse import csr, offsets
from cloak_core.exchange.profiles import Profile

WARM, COLD = 0.2, 0.01
"""The temperature's ends, in squared units of colour."""
FREE_UNTIL, HARD_FROM = 0.25, 0.6
"""Shares of the run: before the one colours are free, after the other each patch has one ink."""


@dataclass(frozen=True, eq=False)
class Inks:
    """The colours there are: given ones, or so many learnt, or so many chosen among given ones."""

    most: int
    given: Float[Tensor, "P 3"] | None = None

    @property
    def learnt(self) -> int:
        """How many are free parameters."""
        return self.most if self.given is None or len(self.given) > self.most else 0


class Pattern:
    """Makes the colours of L faces of N + K free parameters: values of N patches (or faces), then K inks."""

    def __init__(
        self,
        smoothing: Smoothing | None = None,
        patch: Int[np.ndarray, " L"] | None = None,
        profile: Profile | None = None,
        inks: Inks | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        """Make a pattern; smoothing: over patches where there are some.

        profile: parameters are then what is sent to the printer, colours what is photographed; inks that are given are
        colours as photographed.
        """
        self.smoothing, self.inks, self.profile = smoothing, inks, profile
        self.learnt = inks.learnt if inks else 0
        self.patch = None if patch is None else torch.from_numpy(patch).to(device)
        self._table = None if profile is None else torch.from_numpy(profile.table).to(device).permute(3, 0, 1, 2)[None]
        self.progress = 0.0
        """How far the run is, 0 to 1: the temperature hangs on it."""

    def __call__(self, values: Float[Tensor, "N 3"]) -> Float[Tensor, "L 3"]:
        """Compute the colours in this part of the run, differentiably."""
        cold = (self.progress - FREE_UNTIL) / (HARD_FROM - FREE_UNTIL)
        temperature = WARM * (COLD / WARM) ** cold if cold < 1 else None
        return self._colors(values, temperature, is_free=cold < 0)

    def finished(self, values: Float[Tensor, "N 3"]) -> Float[Tensor, "L 3"]:
        """Compute the colours if the run ended here."""
        return self._colors(values, None)

    def reach(self, step: int, steps: int) -> bool:
        """Say that `step` of `steps` begins; whether this is the moment to choose the inks that are learnt."""
        self.progress = step / steps
        return bool(self.learnt) and step == math.ceil(FREE_UNTIL * steps)

    def with_inks(self, values: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
        """Set the inks to the means of clusters of the patches' values; leave them where these are few."""
        smoothed = values[: -self.learnt] if self.smoothing is None else self.smoothing(values[: -self.learnt])
        own = smoothed.detach().cpu().double().numpy()
        if len(np.unique(own, axis=0)) < self.learnt:
            return values
        means, _ = kmeans2(own, self.learnt, minit="++", seed=np.random.default_rng(0))
        return torch.cat([values[: -self.learnt], torch.from_numpy(means).to(values)])

    def begin(self, first: Float[Tensor, "L 3"]) -> Float[Tensor, "N 3"]:
        """Find parameters that come out as these colours, or near them, before any ink is assigned."""
        values = first
        if self.patch is not None:
            members = [np.bincount(self.patch.cpu(), channel) for channel in first.cpu().numpy().T]
            values = torch.from_numpy(np.stack(members, 1) / np.bincount(self.patch.cpu())[:, None]).to(first)
        if self.profile is not None:
            values = torch.from_numpy(self.profile.to_send(values.cpu().numpy())).to(first)
        if not self.learnt:
            return values
        return torch.cat([values, torch.from_numpy(self._first_inks()).to(first)])

    def _colors(self, values: Tensor, temperature: float | None, is_free: bool = False) -> Tensor:
        own, inks = values[: len(values) - self.learnt], values[len(values) - self.learnt :]
        own = own if self.smoothing is None else self.smoothing(own)
        own = self._photographed(own)
        if self.inks is not None and not is_free:
            own = assigned(own, self._inks(inks, len(own), temperature), temperature)
        return own if self.patch is None else own[self.patch]

    def _inks(self, values: Float[Tensor, "K 3"], patches: int, temperature: float | None) -> Float[Tensor, "P 3"]:
        given = self.inks.given
        if not self.learnt:
            return given
        # An ink's gradient is the sum of its patches'; made their mean, it moves as they do under every optimiser.
        share = self.learnt / patches
        inks = self._photographed(share * values + (1 - share) * values.detach())
        return inks if given is None else assigned(inks, given, temperature)

    def _photographed(self, sent: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
        if self._table is None or not len(sent):
            return sent
        # grid_sample's first coordinate is the table's last axis.
        place = (2 * sent.flip(1) - 1).view(1, 1, 1, -1, 3)
        return F.grid_sample(self._table, place, padding_mode="border", align_corners=True).view(3, -1).T

    def _first_inks(self) -> Float[np.ndarray, "K 3"]:
        """Choose inks far apart among all there may be, which a run that ends early has to go by."""
        steps = np.linspace(0.1, 0.9, 5)
        there_are = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        if self.inks.given is not None:
            there_are = self.inks.given.cpu().numpy()
            there_are = there_are if self.profile is None else self.profile.to_send(there_are)
        return far_apart(there_are, self.learnt).astype(np.float32)


def assigned(
    values: Float[Tensor, "N 3"], inks: Float[Tensor, "K 3"], temperature: float | None
) -> Float[Tensor, "N 3"]:
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


class Smoothing:
    """So many rounds in which each face takes a share of its neighbours' values.

    Face i takes 1 / (1 + max(d_i, d_j)) of neighbour j, d the numbers of neighbours, and keeps the rest (Metropolis
    and Hastings' weights): a symmetric matrix W whose rows sum to 1. So values stay within the bounds they had, the
    mean colour stays, and the gradient goes through the same matrix.
    """

    def __init__(
        self, edges: Int[np.ndarray, "E 2"], count: int, rounds: int, device: torch.device | str = "cpu"
    ) -> None:
        """Build the matrix; edges: positions of two neighbouring faces among the `count`."""
        self.rounds = rounds
        pairs = np.unique(np.sort(edges, axis=1), axis=0)
        degree = np.bincount(pairs.ravel(), minlength=count)
        weight = 1 / (1 + np.maximum(degree[pairs[:, 0]], degree[pairs[:, 1]]))
        own = 1 - np.bincount(pairs.ravel(), np.repeat(weight, 2), count)
        diagonal = np.arange(count)
        row = np.concatenate([pairs[:, 0], pairs[:, 1], diagonal])
        column = np.concatenate([pairs[:, 1], pairs[:, 0], diagonal])
        value = np.concatenate([weight, weight, own])
        order = np.lexsort((column, row))
        rows, columns, values = (torch.from_numpy(x[order]).to(device) for x in (row, column, value))
        self.matrix = csr(offsets(rows, count), columns, values.float(), (count, count))

    def __call__(self, values: Float[Tensor, "L C"]) -> Float[Tensor, "L C"]:
        """Average the values; they stay within [0, 1] where the given ones do."""
        return _Averaged.apply(values, self)

    def averaged(self, values: Float[Tensor, "L C"]) -> Float[Tensor, "L C"]:
        for _ in range(self.rounds):
            values = self.matrix @ values
        return values


class _Averaged(torch.autograd.Function):
    """W applied n times; its gradient is W applied n times."""

    @staticmethod
    def forward(ctx: object, values: Tensor, smoothing: Smoothing) -> Tensor:
        ctx.smoothing = smoothing
        # Rounding may carry a mean a hair beyond what it is the mean of.
        return smoothing.averaged(values).clamp(0, 1)

    @staticmethod
    def backward(ctx: object, upstream: Tensor) -> tuple[Tensor, None]:
        return ctx.smoothing.averaged(upstream), None
