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
    """SGD, Adam, or mi: sign steps along a momentum of normalised gradients (MI-FGSM, Dong et al., CVPR 2018)."""
    lr: Positive = 0.1
    """Learning rate, in units of colour [0, 1]."""
    momentum: Annotated[float, Bounds(0, 1, "[)")] = 0.0
    """For sgd and mi, in [0, 1)."""
    sharpness: Annotated[float, Bounds(0, 0.5)] = 0.0
    """Take the gradient where colours are worse by this much, root mean square (sharpness-aware minimisation, Foret et
    al., ICLR 2021); 0 switches it off."""
    ascent: Literal["gradient", "momentum"] = "gradient"
    """With --sharpness, how the worse colours are found: along the gradient, which doubles the cost of a step, or along
    the optimiser's momentum, which costs nothing (Becker et al., 2024)."""
    smooth: Annotated[int, Bounds(0, 1000)] = 0
    """Rounds of averaging with neighbouring faces between the free parameters and the colours, so that only low
    frequencies are learnt; 0 gives each face its own colour."""
    schedule: Literal["constant", "step", "cosine"] = "step"
    """Learning rate over time: constant, times 0.1 every --lr-epochs (step), or a cosine that ends at 1 %."""
    lr_epochs: Positive = 10.0
    """With --schedule step: epochs between drops."""
    gamut: Literal["projection", "sigmoid"] = "projection"
    """How colours stay in [0, 1]: projection after every update, or the sigmoid of free parameters."""
    initial: Literal["grey", "random", "clothing", "animal"] = "grey"
    """First colours: grey; random, uniform per face and channel; clothing, the first outfit; or animal, a dog's face on
    front and back, which helps against detectors of many classes."""
    init: str | None = None
    """Begin with these colours instead: a run folder of the same logo, zoo:NAME, or colours [L, 3] (`cloak logo
    transfer`)."""

    def check(self) -> None:
        """InputError: values that do not go together."""
        if self.optimizer == "adam" and self.momentum:
            raise InputError("--momentum: Adam has its own, give it with --optimizer sgd")
        if self.sharpness and self.ascent == "momentum" and self.optimizer == "sgd" and not self.momentum:
            raise InputError("--ascent momentum: there is none without --momentum")
