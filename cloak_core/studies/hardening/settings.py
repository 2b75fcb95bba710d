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
    """Stop in order (checkpoint and detector written, resumable) after this much training time, seconds."""
    batch: Annotated[int, Bounds(1, 4096)] = 6
    """Rendered images per update, in a cloak."""
    clean: Annotated[int, Bounds(0, 4096)] = 3
    """How many of these images are also shown in their own clothes."""
    cloaked_weight: Annotated[float, Bounds(0, 1000, "(]")] = 4.0
    """Weight of images with a cloak in the last fifth of the updates (1 before): more is more robust, less keeps more
    of the answers without cloaks."""
    perturbation: Annotated[float, Bounds(0, 0.5)] = 0.0157
    """Beside its cloak, how far each pixel may be moved (l-infinity norm), in units of colour; 0.0157 is 4/255."""
    replays: Annotated[int, Bounds(1, 100)] = 2
    """Updates on a turn's images where they are perturbed, each along the slope of the one before."""
    pictures: Annotated[int, Bounds(0, 4096)] = 3
    """Pictures per update, backgrounds and photographs in turn, of which the detector is to say what it said."""
    decoys: Annotated[int, Bounds(0, 4096)] = 5
    """Such pictures per update with patterned cloth that nobody wears, of which the detector is to say what it said
    without."""
    people_share: Annotated[float, Bounds(0, 1)] = 0.3
    """Share of the images in a cloak that are photographs of people, where there are any (--people)."""
    attack_steps: Annotated[int, Bounds(0, 1000)] = 20
    """Steps of an update's cloak against the detector as it stands."""
    cloths: Annotated[float, Bounds(0, 1)] = 0.3
    """Share of the new cloaks that are a cloth that repeats every 20 to 55 cm."""
    hide: Hide = "person"
    """From what the cloaks of the hardening hide: the class person alone, or every class on the body."""
    attack_lr: Annotated[float, Bounds(0, 1, "(]")] = 0.1
    """Their learning rate (Adam), in units of colour."""
    lr: Annotated[float | None, Bounds(0, 1, "()")] = None
    """Learning rate of the detector (AdamW) at its height. None: 1e-3 for the built-in detector and Darknet's, 1e-4 for
    others."""
    sure: Annotated[float, Bounds(0, 1, "[)")] = 0.9
    """Where the unhardened detector reports the rendered person, it is to be at least so sure; 0: as sure as it was."""
    average: Annotated[float, Bounds(0, 1, "[)")] = 0.99
    """Decay of the running average of the weights, which is what gets written."""
    size: Annotated[int, Bounds(32, 4096)] = 320
    """Width and height of the rendered images, pixels."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """Precision of the network while it learns and is attacked; auto: bfloat16 on processors with matrix tiles (AMX),
    where it takes half the time, else float32."""
    checkpoint_every: Annotated[int, Bounds(1, 10_000_000)] = 50
    """Steps between checkpoints."""
    seed: Annotated[int, Bounds(0, 2**63 - 1)] = 0
    """Every random draw derives from it."""

    def __post_init__(self) -> None:
        check_settings(self)
