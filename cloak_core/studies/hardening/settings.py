"""How a detector is hardened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.core.settings import check_settings
from cloak_core.core.settings.components import Hide
from cloak_core.core.settings.values import Bounds


@dataclass(frozen=True, kw_only=True)
class HardenSettings:
    """How a detector is hardened; docs/hardening.md says what was measured, and with which settings."""

    steps: Annotated[int, Bounds(1, 10_000_000)] = 2400
    """Updates of the detector."""
    max_seconds: Annotated[float | None, Bounds(ends="()")] = None
    """Stop after this many seconds of training, with a checkpoint to resume from."""
    batch: Annotated[int, Bounds(1, 4096)] = 6
    """Rendered images in a cloak per update."""
    clean: Annotated[int, Bounds(0, 4096)] = 3
    """How many of these are also shown in own clothes."""
    cloaked_weight: Annotated[float, Bounds(0, 1000, "(]")] = 4.0
    """Weight of images with a cloak in the last fifth of the updates (1 before): more is more robust, less changes
    other answers less."""
    perturbation: Annotated[float, Bounds(0, 0.5)] = 0.0157
    """How far each pixel is moved beside its cloak (l-infinity norm), in units of colour; 0.0157 is 4/255."""
    replays: Annotated[int, Bounds(1, 100)] = 2
    """Updates on the same perturbed images, each along the slope of the one before."""
    pictures: Annotated[int, Bounds(0, 4096)] = 3
    """Backgrounds and photographs per update on which the detector keeps its answers."""
    decoys: Annotated[int, Bounds(0, 4096)] = 5
    """Such pictures with patterned cloth that nobody wears."""
    people_share: Annotated[float, Bounds(0, 1)] = 0.3
    """With --people: share of photographs among the images."""
    attack_steps: Annotated[int, Bounds(0, 1000)] = 20
    """Steps of an update's cloak against the detector."""
    cloths: Annotated[float, Bounds(0, 1)] = 0.3
    """Share of cloaks that are a cloth repeating every 20 to 55 cm."""
    hide: Hide = "person"
    """What cloaks hide: the class person, or every class on the body."""
    attack_lr: Annotated[float, Bounds(0, 1, "(]")] = 0.1
    """Learning rate of cloaks (Adam), in units of colour."""
    lr: Annotated[float | None, Bounds(0, 1, "()")] = None
    """Highest learning rate (AdamW); None: 1e-3 for the built-in detector and Darknet's, else 1e-4."""
    sure: Annotated[float, Bounds(0, 1, "[)")] = 0.9
    """Score to reach where the detector reported the person before; 0: what it was."""
    average: Annotated[float, Bounds(0, 1, "[)")] = 0.99
    """Decay of the running average of the weights, which is what is written."""
    size: Annotated[int, Bounds(32, 4096)] = 320
    """Width and height of the images, pixels."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """auto: bfloat16 on processors with matrix tiles (AMX), in half the time, else float32."""
    checkpoint_every: Annotated[int, Bounds(1, 10_000_000)] = 50
    """Steps between checkpoints."""
    seed: Annotated[int, Bounds(0, 2**63 - 1)] = 0
    """Seed of every random draw."""

    def __post_init__(self) -> None:
        check_settings(self)
