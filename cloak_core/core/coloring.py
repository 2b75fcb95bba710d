"""From free parameters to colours, and back to the parameters that a training begins with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.linear import SparseMap
from cloak_core.core.pattern import Pattern
from cloak_core.core.technique import NO_TECHNIQUES, Techniques


class Coloring:
    """Makes C colours of free parameters: coarse grids' nodes, then N values, then rows for `choose`.

    In this order: grids are added, the sigmoid (gamut sigmoid), neighbours are averaged, `tone`, `choose`, the
    pattern's `spread`, `keep`.
    """

    def __init__(
        self,
        techniques: Techniques = NO_TECHNIQUES,
        pattern: Pattern | None = None,
        is_sigmoid: bool = False,
        octaves: SparseMap | None = None,
        smooth: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        """octaves: see `octave_sums`; smooth: averages values in [0, 1] over their neighbours."""
        self.is_sigmoid = is_sigmoid
        self._pattern = pattern or Pattern()
        self._octaves = octaves
        self._smooth = smooth
        self._tone, self._choose, self._keep = map(techniques.at, ("tone", "choose", "keep"))
        is_shared = pattern is not None and pattern.value_count < pattern.count
        is_changed = is_sigmoid or octaves is not None or smooth is not None or self._tone or self._choose
        self.is_direct = not is_shared and not is_changed
        """Whether parameters are the colours."""

    def begin(self, first: Float[Tensor, "C 3"]) -> Float[Tensor, "P 3"]:
        """Find parameters that come out as these colours, or near them, before anything is chosen."""
        values = torch.from_numpy(self._pattern.means(first.cpu().numpy())).to(first)
        if self._tone:
            values = torch.from_numpy(self._untoned(values.cpu().numpy())).to(first)
        chosen = [
            torch.from_numpy(technique.first_rows(self._untoned)).to(first)
            for technique in self._choose
            if technique.rows
        ]
        nodes = values.new_zeros(self._octaves.width if self._octaves is not None else 0, 3)
        return torch.cat([nodes, *map(self._raw, [values, *chosen])])

    def __call__(self, parameter: Float[Tensor, "P 3"], is_final: bool = False) -> Float[Tensor, "C 3"]:
        """Compute the colours in this part of the run, differentiably; is_final: as if it ended here."""
        if self.is_direct:
            return parameter
        values, chosen = self._mixed(parameter)
        values = self._toned(values)
        for technique, rows in zip(self._choose, chosen, strict=True):
            values = technique.choose(values, rows, self._toned, is_final)
        colors = self._pattern.spread(values)
        if not self._keep:
            return colors
        # Straight through: what is cut off may still come back.
        return self.kept(colors) + (colors - colors.detach())

    @torch.no_grad()
    def kept(self, colors: Float[Tensor, "C 3"]) -> Float[Tensor, "C 3"]:
        """Project colours onto those that are allowed."""
        for technique in self._keep:
            colors = technique.keep(colors)
        return colors

    @torch.no_grad()
    def reach(self, step: int, steps: int, parameter: Float[Tensor, "P 3"]) -> None:
        """Say that `step` of `steps` begins; techniques may set the rows that they choose by."""
        end = len(parameter)
        for technique in reversed(self._choose):
            begun = technique.reach(step, steps, lambda: self._mixed(parameter)[0])
            if begun is not None:
                parameter[end - technique.rows : end] = self._raw(torch.from_numpy(begun).to(parameter))
            end -= technique.rows

    def _mixed(self, parameter: Tensor) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Split the parameters; bring them into [0, 1], the values mixed."""
        nodes = 0 if self._octaves is None else self._octaves.width
        after = [technique.rows for technique in self._choose]
        coarse, values, *chosen = parameter.split([nodes, len(parameter) - nodes - sum(after), *after])
        if self._octaves is not None:
            values = values + self._octaves(coarse)
        if self.is_sigmoid:
            values = torch.sigmoid(values)
            chosen = map(torch.sigmoid, chosen)
        return values if self._smooth is None else self._smooth(values), tuple(chosen)

    def _toned(self, values: Float[Tensor, "M 3"]) -> Float[Tensor, "M 3"]:
        for technique in self._tone:
            values = technique.tone(values)
        return values

    def _untoned(self, colors: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "M 3"]:
        for technique in reversed(self._tone):
            colors = technique.untone(colors)
        return colors

    def _raw(self, values: Tensor) -> Tensor:
        # 0.02 from the ends, where a sigmoid still moves.
        return torch.logit(values.clamp(0.02, 0.98)) if self.is_sigmoid else values.clone()
