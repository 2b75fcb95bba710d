"""How a detector is hardened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.core.settings import check_settings
from cloak_core.core.settings.components import Hide
from cloak_core.core.settings.values import Bounds


@dataclass(frozen=True, kw_only=True)
class HardenSettings:
    """How a detector is hardened; docs/defence.md says what was measured, and with which settings."""

    steps: Annotated[int, Bounds(1, 10_000_000)] = 2400
    """Updates of the detector."""
    max_seconds: Annotated[float | None, Bounds(ends="()")] = None
    """Stop in order (checkpoint and detector written, resumable) after this much training time, seconds."""
    batch: Annotated[int, Bounds(1, 4096)] = 6
    """Rendered images per update, in a cloak."""
    clean: Annotated[int, Bounds(0, 4096)] = 3
    """How many of these images are also shown in their own clothes."""
    cloaked_weight: Annotated[float, Bounds(0, 1000, "(]")] = 4.0
    """How much an image in a cloak counts beside one without and a picture in the last fifth of the updates; before it
    counts 1. More makes the detector more robust, less keeps more of its answers without cloaks."""
    pictures: Annotated[int, Bounds(0, 4096)] = 3
    """Pictures per update, backgrounds and photographs in turn, of which the detector is to say what it said."""
    decoys: Annotated[int, Bounds(0, 4096)] = 5
    """Such pictures per update with patterned cloth that nobody wears (panels, curtains, boxes, racks, dummies), of
    which the detector is to say what it said without the cloth."""
    finished: Annotated[int, Bounds(0, 256)] = 4
    """Cloaks that are trained against the unhardened detector before its first update, for such cloth alone: those of
    the pool are young at first, and a strong cloak on nobody looks otherwise."""
    people_share: Annotated[float, Bounds(0, 1)] = 0.3
    """Share of the images in a cloak that are photographs of people, where there are any (--people)."""
    cloaks: Annotated[int, Bounds(1, 256)] = 6
    """Cloaks that are kept and attacked further, one after the other, each seen from a distance of its own. Every
    second one covers the whole body, the others random parts of it."""
    life: Annotated[int, Bounds(1, 100_000)] = 128
    """Turns after which a cloak makes room for a new one, on another logo and from other colours. A cloak is updated
    attack_steps times a turn. With a short life it stays weak, and the detector learns to withstand only weak ones."""
    attack_steps: Annotated[int, Bounds(0, 1000)] = 3
    """Steps of a cloak against the detector as it stands, before each update."""
    hide: Hide = "person"
    """From what the cloaks of the hardening hide: the class person alone, or every class on the body."""
    attack_lr: Annotated[float, Bounds(0, 1, "(]")] = 0.05
    """Their learning rate (Adam) when they are new, in units of colour; over a life it falls like that of preset best.
    0.1 is too much: colours flicker, and after 60 steps nothing was hidden where 0.03 to 0.05 hid more than 0.8."""
    lr: Annotated[float, Bounds(0, 1, "()")] = 1e-3
    """Learning rate of the detector (AdamW), at its height; warm-up, then a cosine down to 0, and for the last fifth of
    the updates another from half the height."""
    sure: Annotated[float, Bounds(0, 1, "[)")] = 0.9
    """Where the unhardened detector reports the rendered person, it is to be at least so sure; 0: as sure as it was."""
    average: Annotated[float, Bounds(0, 1, "[)")] = 0.99
    """Decay of the running average of the weights, which is what gets written."""
    size: Annotated[int, Bounds(32, 4096)] = 320
    """Width and height of the rendered images, pixels."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Precision of the network while it learns and is attacked; what is written has float32 either way. bfloat16 takes
    less than half the time on processors made for it (AMX); with AVX2 alone ten times as long. GPUs: not measured."""
    checkpoint_every: Annotated[int, Bounds(1, 10_000_000)] = 50
    """Steps between checkpoints."""
    seed: Annotated[int, Bounds(0, 2**63 - 1)] = 0
    """Every random draw derives from it."""

    def __post_init__(self) -> None:
        check_settings(self)
