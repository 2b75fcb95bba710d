"""Settings of `attack.loop`: how long a run is, what it keeps, and where it is computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cloak_core.attack.settings.values import Bounds
from cloak_core.files.errors import InputError


@dataclass(frozen=True, kw_only=True)
class ComputeSettings:
    """Where to compute."""

    # A command prepares its process by them (`commands.compute`); functions leave the process as it is.

    device: str = "cpu"
    """Torch device: cpu, cuda, cuda:1."""
    threads: Annotated[int | None, Bounds(1, 4096)] = None
    """CPU threads of torch; None leaves them as they are. Bit-identical results need equal numbers."""


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """How long the run is, and what it keeps."""

    epochs: Annotated[float | None, Bounds(ends="()")] = 100.0
    """Passes over the data, instead of --steps; an epoch shows every background once at every training angle."""
    steps: Annotated[int | None, Bounds(1, 10_000_000)] = None
    """Updates of the colours, instead of --epochs."""
    batch: Annotated[int, Bounds(1, 4096)] = 8
    """Images per update."""
    microbatch: Annotated[int | None, Bounds(1, 4096)] = None
    """Images that a detector sees at once, to bound memory; None: the whole batch. The gradient is the same up to
    rounding."""
    max_seconds: Annotated[float | None, Bounds(ends="()")] = None
    """Stop after this much training time, seconds, with a checkpoint to resume from."""
    held_out: Annotated[float, Bounds(0, 0.5)] = 0.0
    """Share of the training poses and backgrounds that is set aside to choose the best colours."""
    held_out_every: Annotated[int, Bounds(1, 10_000_000)] = 50
    """Steps between measurements on the held-out share."""
    patience: Annotated[int, Bounds(0, 10_000_000)] = 0
    """Stop after this many measurements in a row without improvement; 0 trains to the end."""
    seed: Annotated[int, Bounds(0, 2**63 - 1)] = 0
    """Every random draw derives from it."""
    threshold: Annotated[float, Bounds(0, 1, "()")] = 0.6
    """Score above which a person counts as detected, in the success that events report."""
    checkpoint_every: Annotated[int, Bounds()] = 100
    """Steps between checkpoints; 0 writes one at the end."""
    preview_every: Annotated[int, Bounds()] = 100
    """Steps between preview pictures; 0 writes none."""
    snapshot_every: Annotated[int, Bounds()] = 0
    """Steps between copies of the colours in RUN/snapshots, for `cloak evaluate --over-time`; 0 keeps none."""

    def check(self) -> None:
        """InputError: values that do not go together."""
        if (self.epochs is None) == (self.steps is None):
            raise InputError("--steps and --epochs: give one of them")
        if self.patience and not self.held_out:
            raise InputError("--patience: needs a share to be set aside, --held-out 0.2 for instance")
