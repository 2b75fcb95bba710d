"""Settings of `attack.optimizing`: how the colours begin and move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.attack.settings.values import Bounds, Positive
from cloak_core.files.errors import InputError


@dataclass(frozen=True, kw_only=True)
class OptimizerSettings:
    """How the colours begin and move."""

    optimizer: Literal["sgd", "adam", "mi"] = "sgd"
    """What follows the gradient; mi: steps of the learning rate along the signs of a momentum of normalised gradients
    (MI-FGSM, Dong et al., CVPR 2018)."""
    lr: Positive = 0.1
    """Learning rate, in units of colour [0, 1]."""
    momentum: Annotated[float, Bounds(0, 1, "[)")] = 0.0
    """Of SGD and mi, [0, 1)."""
    sharpness: Annotated[float, Bounds(0, 0.5)] = 0.0
    """The gradient is taken where colours are worse by so much (root mean square, in units of colour), so that they
    end where all around is good, too (SAM, Foret et al., ICLR 2021); 0 switches it off."""
    ascent: Literal["gradient", "momentum"] = "gradient"
    """Which way is worse: up the gradient, which is taken first and doubles the cost of a step, or up the optimiser's
    own momentum, which costs nothing (Becker et al., 2024)."""
    smooth: Annotated[int, Bounds(0, 1000)] = 0
    """Colours are those of free parameters after so many rounds of averaging with neighbouring faces: what is finer
    cannot be learned. 0 leaves each face its own."""
    schedule: Literal["constant", "step", "cosine"] = "step"
    """Learning rate over time: constant, times 0.1 every so many epochs (step), or a cosine that ends at 1 %."""
    lr_epochs: Positive = 10.0
    """Epochs between the drops of schedule step."""
    gamut: Literal["projection", "sigmoid"] = "projection"
    """Colours stay in [0, 1] by a projection after every update, or as the sigmoid of free parameters."""
    initial: Literal["grey", "random", "clothing", "animal"] = "grey"
    """First colours: grey, random (uniform per face and channel), those of the first outfit, or a dog's face drawn on
    the front and on the back: what transfers to detectors of many classes tends to end as one."""
    init: str | None = None
    """Go on from these colours instead: a run folder of the same logo, zoo:NAME, or colours [L, 3] (`cloak logo
    transfer`)."""

    def check(self) -> None:
        """InputError: values that do not go together."""
        if self.optimizer == "adam" and self.momentum:
            raise InputError("--momentum: Adam has its own, give it with --optimizer sgd")
        if self.sharpness and self.ascent == "momentum" and self.optimizer == "sgd" and not self.momentum:
            raise InputError("--ascent momentum: there is none without --momentum")
