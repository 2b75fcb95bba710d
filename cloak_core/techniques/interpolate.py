"""Keeping a share of the first colours in what is written. Such a cloth hides people from more detectors.

Of networks, the mean of the weights before and after fine-tuning is right more often on data of other kinds than either
(WiSE-FT: Wortsman et al., "Robust fine-tuning of zero-shot models", CVPR 2022). Here the weights are a cloth's colours,
the beginning is a print that already hides people from many detectors, and the other kinds are other detectors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from jaxtyping import Float

from cloak_core.core.prints import PRINTS
from cloak_core.core.settings.values import Bounds
from cloak_core.core.technique import Setup, Technique
from cloak_core.files.errors import InputError
from cloak_core.files.lazy import Lazy

torch = Lazy("torch")
_STATE = "interpolate.first"


@dataclass(frozen=True, kw_only=True)
class InterpolateSettings:
    initial_share: Annotated[float, Bounds(0, 1, "[)")] = 0.0
    """Share of the first colours in what is written: 0 writes what training found, 0.5 the mean of both (WiSE-FT,
    Wortsman et al., CVPR 2022). Where training begins with a print, 0.5 hides more people from detectors that it never
    saw. Needs a print (--initial) or --init."""

    def check(self) -> None:
        """Check that values go together. InputError: they do not."""
        if self.initial_share and self.initial not in PRINTS and self.init is None:
            hint = f"with --initial {self.initial} give --initial-share 0"
            raise InputError(f"--initial-share: keeps a share of a print or of --init; {hint}")


class Interpolate(Technique):
    """Mixes the first colours into the last ones, when they are written. Training itself sees none of it."""

    group = "optimization"
    settings = InterpolateSettings
    order = -1  # inks are chosen for what is written
    bars_search = True

    def __init__(self, share: float) -> None:
        """share: of the first colours, 0 to 1."""
        self.share = share
        self._first: torch.Tensor | None = None
        """[N, 3], as they are before `tone`; None until the first step begins."""

    @classmethod
    def build(cls, setup: Setup) -> Interpolate | None:
        share = setup.settings.optimization.initial_share
        return cls(share) if share else None

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


TECHNIQUE = Interpolate
