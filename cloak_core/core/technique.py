"""What an optional technique of training is: five hooks by which it acts. No technique is named here.

Each file of `cloak_core/techniques` is one, and a package may bring others: a subclass of `Technique` that overrides
the hooks where it acts. Its settings stand among those of the component that it belongs to
(`core.settings.components`). Whatever it draws at random is a function of (seed, step), so that it needs no state in
checkpoints. Off, it is not built.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float


class Technique:
    """Does nothing; each technique overrides the hooks where it acts."""

    def detector_context(self, number: int, step: int) -> contextlib.AbstractContextManager:
        """Make the context in which detector `number` runs in `step` of a training."""

    name: ClassVar[str]
    """Under what name events have its penalty."""

    def penalty(self, colors: Float[torch.Tensor, "C 3"]) -> tuple[float, Float[torch.Tensor, ""]]:
        """Compute what is added to the loss: its weight, and the figure that events have under `name`."""

    def project(self, colors: Float[torch.Tensor, "C 3"]) -> Float[torch.Tensor, "C 3"]:
        """Project colours onto those that are allowed; a mean of two of these may not be."""

    def content(self) -> dict[str, object]:
        """Record the content of the files that it reads, by the name in config.json (`run_config.FILES`)."""
        return {}

    def report(self, colors: Float[np.ndarray, "C 3"]) -> dict[str, float]:
        """Measure the colours that a run ends with, for its result."""
        return {}


class Techniques(tuple[Technique, ...]):
    """Those of a run that are on, in the order of their hooks."""

    def at(self, hook: str) -> list[Technique]:
        """List those that act at a hook."""
        return [technique for technique in self if getattr(type(technique), hook) is not getattr(Technique, hook)]

    @contextlib.contextmanager
    def detector_context(self, number: int, step: int | None) -> Iterator[None]:
        """Surround a detector's run in `step`; None, outside training, changes nothing."""
        with contextlib.ExitStack() as stack:
            for technique in [] if step is None else self.at("detector_context"):
                stack.enter_context(technique.detector_context(number, step))
            yield


NO_TECHNIQUES = Techniques()
