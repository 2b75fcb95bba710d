"""The optional techniques of training, a file each. Their settings stand in `core.settings.components`."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings import TrainSettings
from cloak_core.core.technique import Technique, Techniques
from cloak_core.exchange.profiles import read_profile
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.logos.palette import read_palette
from cloak_core.techniques.inks import Inks
from cloak_core.techniques.interpolate import Interpolate
from cloak_core.techniques.near import Near, read_garment
from cloak_core.techniques.printability import Printability
from cloak_core.techniques.profile import Photographed
from cloak_core.techniques.shake import Shake


def build_techniques(
    settings: TrainSettings, pattern: Pattern, detectors: Sequence[Detector], device: torch.device
) -> Techniques:
    """Build the techniques that the settings have on, in the order of their hooks. InputError: one does not fit.

    pattern: what has colours.
    """
    colors, objective, optimization = settings.pattern, settings.objective, settings.optimization
    palette = None if objective.palette is None else read_palette(objective.palette)
    built: list[Technique] = []
    if optimization.initial_share:  # before inks, which are chosen for what is written
        built.append(Interpolate(optimization.initial_share))
    if colors.colors_at_most is not None:
        fixed = None if palette is None else torch.as_tensor(palette, dtype=torch.float32, device=device)
        built.append(Inks(colors.colors_at_most, fixed))
    if colors.near is not None:
        garment = read_garment(settings, pattern)
        built.append(Near(garment, colors.within, 2 * colors.within))
    if palette is not None:
        built.append(Printability(objective.nps_weight, palette, device))
    if colors.profile is not None:
        built.append(Photographed(read_profile(colors.profile), device))
    if settings.surrogates.shake:
        for detector in detectors:
            if detector.compiled:
                raise InputError(f"--detector {detector.spec}: compiled, so --shake does not reach into it")
        built.append(Shake(settings.surrogates.shake, settings.run.seed))
    return Techniques(built)
