"""From free parameters to colours, and back to the parameters that a training begins with."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.pattern import Pattern
from cloak_core.core.technique import NO_TECHNIQUES, Techniques


class Coloring:
    """Makes C colours of free parameters: rows for `free`, then N values, then rows for `choose`.

    In this order: `free`, the sigmoid (gamut sigmoid), `mix`, `tone`, `choose`, the pattern's `spread`, `keep`.
    """

    def __init__(
        self, techniques: Techniques = NO_TECHNIQUES, pattern: Pattern | None = None, is_sigmoid: bool = False
    ) -> None:
        self.is_sigmoid = is_sigmoid
        self._pattern = pattern or Pattern()
        self._free, self._mix, self._tone, self._choose, self._keep = map(
            techniques.at, ("free", "mix", "tone", "choose", "keep")
        )
        is_shared = pattern is not None and pattern.value_count < pattern.count
        is_plain = not is_shared and not self._mix and not self._tone and not self._choose
        self.is_direct = is_plain and not is_sigmoid and not self._free
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
        rows = [values.new_zeros(technique.rows, 3) for technique in self._free]
        return torch.cat([*rows, *map(self._raw, [values, *chosen])])

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
        before, after = ([technique.rows for technique in group] for group in (self._free, self._choose))
        count = len(parameter) - sum(before) - sum(after)
        parts = parameter.split([*before, count, *after])
        values, chosen = parts[len(before)], parts[len(before) + 1 :]
        for technique, rows in zip(self._free, parts, strict=False):
            values = technique.free(values, rows)
        if self.is_sigmoid:
            values = torch.sigmoid(values)
            chosen = tuple(map(torch.sigmoid, chosen))
        for technique in self._mix:
            values = technique.mix(values)
        return values, chosen

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
