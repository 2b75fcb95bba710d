"""What an optional technique of training is: the hooks by which it acts. No technique is named here.

Each file of `cloak_core/techniques` is one: a subclass of `Technique` with the hooks where it acts. Its settings stand
among those of the component that it belongs to (`core.settings.components`). A step calls the hooks in this order:
`tone`, `choose`, `keep` (from free parameters to colours); `around` (while a detector runs), `penalty`.

Whatever a technique draws at random is a function of (seed, step). Off, it is not built.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float


class Technique:
    """Does nothing; each technique overrides the hooks where it acts."""

    is_exact: ClassVar[bool] = False
    """Colours are restricted, so that a mean of two may not be allowed."""
    bars_search: ClassVar[bool] = False
    """Cannot be combined with --black-box-queries."""

    # --- on the detector and the loss

    def around(self, number: int, step: int) -> contextlib.AbstractContextManager:
        """Make the context in which detector `number` runs in `step` of a training."""

    def penalty(self, colors: Float[torch.Tensor, "C 3"]) -> tuple[float, Float[torch.Tensor, ""]]:
        """Compute what is added to the loss: its weight, and the figure that events have under `name`."""

    name: ClassVar[str]
    """Under what name events have its penalty."""

    # --- on the colours: N values that are free parameters become C colours

    rows: int = 0
    """Free parameters of its own, beside the N values."""

    def tone(self, values: Float[torch.Tensor, "N 3"]) -> Float[torch.Tensor, "N 3"]:
        """Change each value by itself."""

    def untone(self, colors: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Find values that `tone` makes these colours, or nearly."""

    def choose(
        self, values: Float[torch.Tensor, "N 3"], own: Float[torch.Tensor, "rows 3"], tone: Callable, is_final: bool
    ) -> Float[torch.Tensor, "N 3"]:
        """Change the values by its own rows, which are in [0, 1]; is_final: as if the run ended here.

        tone: what other techniques do to each value.
        """

    def first_rows(self, untone: Callable) -> Float[np.ndarray, "rows 3"]:
        """Give what the rows for `choose` begin with."""

    def reach(self, step: int, steps: int, values: Callable) -> Float[np.ndarray, "rows 3"] | None:
        """Hear that `step` of `steps` begins; give new rows for `choose`. `values()`: the mixed values, [N, 3]."""

    def keep(self, colors: Float[torch.Tensor, "C 3"]) -> Float[torch.Tensor, "C 3"]:
        """Project colours onto those that are allowed."""

    # --- on what is written

    def content(self) -> dict[str, object]:
        """Record the content of the files that it reads, by the name in config.json (`run_config.FILES`)."""
        return {}

    def report(self, colors: Float[np.ndarray, "C 3"]) -> dict[str, float]:
        """Measure the colours that a run ends with, for its result."""
        return {}

    def state(self) -> dict[str, torch.Tensor]:
        """Give the state for a checkpoint."""
        return {}

    def load(self, tensors: dict[str, torch.Tensor]) -> None:
        """Continue from `state()`. KeyError or ValueError where the tensors belong to another run."""


class Techniques(tuple[Technique, ...]):
    """Those of a run that are on, in the order of their hooks."""

    def at(self, hook: str) -> list[Technique]:
        """List those that act at a hook."""
        return [technique for technique in self if getattr(type(technique), hook) is not getattr(Technique, hook)]

    @contextlib.contextmanager
    def around(self, number: int, step: int | None) -> Iterator[None]:
        """Surround a detector's run in `step`; None, outside training, changes nothing."""
        with contextlib.ExitStack() as stack:
            for technique in [] if step is None else self.at("around"):
                stack.enter_context(technique.around(number, step))
            yield

    def content(self) -> dict[str, object]:
        """Record the content of every technique's files."""
        return {name: value for technique in self for name, value in technique.content().items()}

    def report(self, colors: Float[np.ndarray, "C 3"]) -> dict[str, float]:
        """Measure the colours that a run ends with, by every technique."""
        return {name: value for technique in self for name, value in technique.report(colors).items()}

    def state(self) -> dict[str, torch.Tensor]:
        """Give every technique's state for a checkpoint."""
        return {name: tensor for technique in self for name, tensor in technique.state().items()}

    def load(self, tensors: dict[str, torch.Tensor]) -> None:
        """Continue from `state()`."""
        for technique in self:
            technique.load(tensors)


NO_TECHNIQUES = Techniques()
