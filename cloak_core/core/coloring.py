"""From free parameters to colours, and back to the parameters that a training begins with.

Every colour that a run shows is made here, in the order of `Coloring.__call__`:

- sums of grids of several scales (a Laplacian pyramid: Burt and Adelson, IEEE Transactions on Communications 31(4),
  1983). Adam moves every parameter about equally far in a step, so that a coarse grid reaches at once what single faces
  reach after many steps in one direction: a preconditioner, as a Fourier basis is one (Olah et al., "Feature
  Visualization", Distill, 2017);
- the sigmoid, and means over neighbours, so that only low frequencies are learnt;
- a printer's and a camera's profile: colours are trained as they are photographed after printing;
- a share of the first colours, in what is written alone. Of networks, the mean of the weights before and after
  fine-tuning is right more often on data of other kinds than either (WiSE-FT: Wortsman et al., "Robust fine-tuning of
  zero-shot models", CVPR 2022). Here the beginning is a print that already hides people from many detectors, and the
  other kinds are other detectors;
- a few inks (`Inks`), colours that share a value (`Pattern.spread`), and what techniques allow.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy import sparse
from torch import Tensor

from cloak_core.core.linear import SparseMap, offsets
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings.components import OptimizerSettings
from cloak_core.core.technique import NO_TECHNIQUES, Techniques
from cloak_core.exchange.profiles import Profile
from cloak_core.files.identity import sha256_arrays

_FIRST = "interpolate.first"
"""Name of the first values in a checkpoint."""
WARM, COLD = 0.2, 0.01
"""Ends of the inks' temperature, in squared units of colour."""
FREE_UNTIL, HARD_FROM = 0.25, 0.6
"""Shares of the run: before the one colours are free, after the other each patch has one ink."""


class Coloring:
    """Makes C colours of free parameters: coarse grids' nodes, then N values, then inks that are learnt."""

    def __init__(
        self,
        settings: OptimizerSettings,
        pattern: Pattern | None = None,
        inks: Inks | None = None,
        profile: Profile | None = None,
        techniques: Techniques = NO_TECHNIQUES,
        device: torch.device | str = "cpu",
    ) -> None:
        """pattern: says where colours lie and which share values; without one, octaves and smoothing are off."""
        self.is_sigmoid = settings.gamut == "sigmoid"
        self._pattern = pattern or Pattern()
        self._inks = inks
        self._profile = profile
        self._share = settings.initial_share
        self._projections = techniques.at("project")
        self._octaves = self._means = None
        if pattern is not None and settings.octaves > 1:
            self._octaves = octave_sums(pattern.points, pattern.spacing, settings.octaves, pattern.period, device)
        if pattern is not None and settings.smooth:
            self._means = neighbour_means(pattern.neighbours, pattern.value_count, device)
        self._rounds = settings.smooth
        self._table = None
        if profile is not None:
            self._table = torch.from_numpy(profile.table).to(device).permute(3, 0, 1, 2)[None]
        self._first: Tensor | None = None
        """[N, 3]: the values that a run with a share of the first colours began with, before the profile."""
        is_shared = pattern is not None and pattern.value_count < pattern.count
        parts = (self._octaves, self._means, inks, profile)
        self.is_direct = not (is_shared or self.is_sigmoid or self._share or any(part is not None for part in parts))
        """Whether parameters are the colours."""
        self.is_restricted = inks is not None or bool(self._projections)
        """Whether the mean of two colours may not be allowed."""

    def begin(self, first: Float[Tensor, "C 3"]) -> Float[Tensor, "P 3"]:
        """Find parameters that come out as these colours, or near them, before inks are assigned."""
        parts = [self._pattern.means(first.cpu().numpy()).astype(np.float32)]
        if self._profile is not None:
            parts = [self._profile.to_send(parts[0])]
        if self._inks is not None and self._inks.rows:
            parts.append(self._inks.first(self._profile))
        nodes = first.new_zeros(0 if self._octaves is None else self._octaves.width, 3)
        parameter = torch.cat([nodes, *(self._raw(torch.from_numpy(part).to(first)) for part in parts)])
        if self._share:
            self._first = self._mixed(parameter)[0].clone()
        return parameter

    def __call__(self, parameter: Float[Tensor, "P 3"], is_final: bool = False) -> Float[Tensor, "C 3"]:
        """Compute the colours in this part of the run, differentiably; is_final: as if it ended here."""
        if self.is_direct:
            return parameter
        values, inks = self._mixed(parameter)
        values = self._photographed(values)
        if is_final and self._first is not None:
            values = torch.lerp(values, self._photographed(self._first.to(values)), self._share)
        if self._inks is not None:
            values = self._inks.assign(values, inks, self._photographed, is_final)
        colors = self._pattern.spread(values)
        if not self._projections:
            return colors
        # Straight through: what is cut off may still come back.
        return self.project(colors) + (colors - colors.detach())

    @torch.no_grad()
    def project(self, colors: Float[Tensor, "C 3"]) -> Float[Tensor, "C 3"]:
        """Let each technique move colours to ones that it allows."""
        for technique in self._projections:
            colors = technique.project(colors)
        return colors

    @torch.no_grad()
    def on_step(self, step: int, steps: int, parameter: Float[Tensor, "P 3"]) -> None:
        """Hear that `step` of `steps` begins: inks that are learnt may begin anew, in place."""
        if self._inks is None:
            return
        begun = self._inks.on_step(step, steps, lambda: self._mixed(parameter)[0])
        if begun is not None:
            parameter[-self._inks.rows :] = self._raw(torch.from_numpy(begun).to(parameter))

    def content(self) -> dict[str, object]:
        """Record the profile's content, for config.json."""
        return {} if self._profile is None else {"profile": {"sha256": sha256_arrays(self._profile.table)}}

    def state(self) -> dict[str, Tensor]:
        """Give what a checkpoint needs beside the parameters."""
        return {} if self._first is None else {_FIRST: self._first}

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state()`. KeyError: the tensors belong to another run."""
        if self._share:
            self._first = tensors[_FIRST]

    def _mixed(self, parameter: Tensor) -> tuple[Tensor, Tensor]:
        """Split the parameters; bring them into [0, 1]: the values, mixed over their neighbours, and the inks."""
        nodes = 0 if self._octaves is None else self._octaves.width
        inks = 0 if self._inks is None else self._inks.rows
        coarse, values, own = parameter.split([nodes, len(parameter) - nodes - inks, inks])
        if self._octaves is not None:
            values = values + self._octaves(coarse)
        if self.is_sigmoid:
            values, own = torch.sigmoid(values), torch.sigmoid(own)
        return values if self._means is None else smoothed(values, self._means, self._rounds), own

    def _photographed(self, values: Float[Tensor, "M 3"]) -> Float[Tensor, "M 3"]:
        """Turn what is sent to the printer into what is photographed, where there is a profile."""
        if self._table is None:
            return values
        # grid_sample's first coordinate is the table's last axis.
        place = (2 * values.flip(1) - 1).view(1, 1, 1, -1, 3)
        sampled = torch.nn.functional.grid_sample(self._table, place, padding_mode="border", align_corners=True)
        return sampled.view(3, -1).T

    def _raw(self, values: Tensor) -> Tensor:
        # 0.02 from the ends, where a sigmoid still moves.
        return torch.logit(values.clamp(0.02, 0.98)) if self.is_sigmoid else values.clone()


class Inks:
    """A few inks: each value ends as one of a few colours, learnt, or given, or chosen among given ones.

    An assignment by rounding at the end throws away what training found. So it is made while training goes on. At first
    colours are free; where inks are learnt, they then begin as the means of clusters of these. From there on a colour
    is a mean of the inks, weighted by how near each is, and the temperature of these weights falls, until for the last
    part of the run each patch has the nearest ink alone. Its gradient then is that of the colour itself, as if nothing
    were assigned (a straight-through estimator: Bengio et al., arXiv 1308.3432), so that a patch may still change its
    ink, and the inks, where they are learnt, their colour.
    """

    def __init__(self, most: int, fixed: Float[Tensor, "F 3"] | None = None) -> None:
        """Take at most `most` inks; fixed: the colours that there are, sRGB in [0, 1]."""
        self.fixed = fixed
        self.rows = most if fixed is None or len(fixed) > most else 0
        """How many inks are free parameters."""
        self.progress = 0.0
        """How far the run is, 0 to 1: the temperature hangs on it."""

    def first(self, profile: Profile | None) -> Float[np.ndarray, "rows 3"]:
        """Choose inks far apart among all there may be, which a run that ends early has to go by."""
        if self.fixed is None:
            steps = np.linspace(0.1, 0.9, 5)
            candidates = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        else:
            candidates = self.fixed.cpu().numpy()
            candidates = candidates if profile is None else profile.to_send(candidates)
        return far_apart(candidates, self.rows).astype(np.float32)

    def on_step(self, step: int, steps: int, values: Callable) -> Float[np.ndarray, "rows 3"] | None:
        """Begin inks that are learnt as means of clusters of `values()`, [N, 3]; leave them where these are few."""
        self.progress = step / steps
        if not self.rows or step != math.ceil(FREE_UNTIL * steps):
            return None
        from scipy.cluster.vq import kmeans2

        own = values().detach().cpu().double().numpy()
        if len(np.unique(own, axis=0)) < self.rows:
            return None
        return kmeans2(own, self.rows, minit="++", seed=np.random.default_rng(0))[0]

    def assign(
        self, values: Float[Tensor, "N 3"], own: Float[Tensor, "rows 3"], photographed: Callable, is_final: bool
    ) -> Float[Tensor, "N 3"]:
        """Assign inks to the values; own: the free parameters, in [0, 1]; is_final: as if the run ended here."""
        cold = (self.progress - FREE_UNTIL) / (HARD_FROM - FREE_UNTIL)
        if cold < 0 and not is_final:
            return values
        temperature = None if is_final or cold >= 1 else WARM * (COLD / WARM) ** cold
        if not self.rows:
            return assigned(values, self.fixed, temperature)
        # An ink's gradient is the sum of its patches'; made their mean, it moves as they do under every optimiser.
        part = self.rows / len(values)
        inks = photographed(part * own + (1 - part) * own.detach())
        return assigned(values, inks if self.fixed is None else assigned(inks, self.fixed, temperature), temperature)


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


def octave_sums(
    points: Float[np.ndarray, "N D"],
    spacing: float,
    count: int,
    period: float | None = None,
    device: torch.device | str = "cpu",
) -> SparseMap:
    """Map the nodes' values of all coarse grids together to their sums at the points.

    Grid k = 1, 2 ... has nodes 2^k times `spacing` apart, and values between them are multilinear. points: of the N
    faces (or squares of a cloth), metres in D dimensions; count: of scales, the faces' own included; period: what
    repeats in every dimension (None: nothing does), into which a whole number of nodes is fitted.
    """
    weights = sparse.hstack([_grid(points, spacing * 2**k, period) for k in range(1, count)], "csr")
    return SparseMap.from_scipy(weights).to(device, torch.float32)


def _grid(points: np.ndarray, spacing: float, period: float | None) -> sparse.csr_matrix:
    """Weights [N, nodes next to a point] of one grid; each row adds up to 1."""
    count = None if period is None else max(1, round(period / spacing))
    at = points / (spacing if count is None else period / count)
    first = np.floor(at).astype(np.int64)
    nodes, weights = [], []
    for corner in itertools.product((0, 1), repeat=points.shape[1]):
        nodes.append(first + corner if count is None else (first + corner) % count)
        weights.append(np.where(corner, at - first, 1 - (at - first)).prod(axis=1))
    used, column = np.unique(np.concatenate(nodes), axis=0, return_inverse=True)
    rows = np.tile(np.arange(len(points)), len(nodes))
    return sparse.csr_matrix((np.concatenate(weights), (rows, column.ravel())), shape=(len(points), len(used)))


def neighbour_means(edges: Int[np.ndarray, "E 2"], count: int, device: torch.device | str = "cpu") -> SparseMap:
    """Make the map in which each of `count` faces takes a share of its neighbours' values.

    Face i takes 1 / (1 + max(d_i, d_j)) of neighbour j, d the numbers of neighbours, and keeps the rest (Metropolis
    and Hastings' weights): a symmetric matrix W whose rows sum to 1. So values stay within the bounds they had, the
    mean colour stays, and the gradient goes through the same matrix. edges: positions of two neighbouring faces.
    """
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
    return SparseMap(offsets(rows, count), columns, values.float(), count)


def smoothed(values: Float[Tensor, "L C"], means: SparseMap, rounds: int) -> Float[Tensor, "L C"]:
    """Average values over neighbours, `rounds` times; they stay within [0, 1] where the given ones do."""
    mean = values
    for _ in range(rounds):
        mean = means(mean)
    # Rounding may carry a mean a hair beyond what it is the mean of; the gradient passes.
    return mean + (mean.clamp(0, 1) - mean).detach()
