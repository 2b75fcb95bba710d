"""Keeping a share of the first colours in what is written. Such a cloth hides people from more detectors.

Of networks, the mean of the weights before and after fine-tuning is right more often on data of other kinds than either
(WiSE-FT: Wortsman et al., "Robust fine-tuning of zero-shot models", CVPR 2022). Here the weights are a cloth's colours,
the beginning is a print that already hides people from many detectors, and the other kinds are other detectors.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float

from cloak_core.core.technique import Technique

_STATE = "interpolate.first"


class Interpolate(Technique):
    """Mixes the first colours into the last ones, when they are written. Training itself sees none of it."""

    bars_search = True

    def __init__(self, share: float) -> None:
        """share: of the first colours, 0 to 1."""
        self.share = share
        self._first: torch.Tensor | None = None
        """[N, 3], as they are before `tone`; None until the first step begins."""

    def reach(self, step: int, steps: int, values: Callable) -> None:
        if self._first is None:
            self._first = values().detach().clone()

    def choose(
        self, values: Float[torch.Tensor, "N 3"], own: Float[torch.Tensor, "rows 3"], tone: Callable, is_final: bool
    ) -> Float[torch.Tensor, "N 3"]:
        if not is_final or self._first is None:
            return values
        return torch.lerp(values, tone(self._first.to(values)), self.share)

    def state(self) -> dict[str, torch.Tensor]:
        return {} if self._first is None else {_STATE: self._first}

    def load(self, tensors: dict[str, torch.Tensor]) -> None:
        self._first = tensors[_STATE]
