"""The optional techniques of training, a file each. Their settings stand in `core.settings.components`."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from cloak_core.core.coloring import Coloring, Inks
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings import TrainSettings
from cloak_core.core.technique import Technique, Techniques
from cloak_core.exchange.profiles import read_profile
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.logos.palette import read_palette
from cloak_core.techniques.near import Near, read_garment
from cloak_core.techniques.printability import Printability
from cloak_core.techniques.shake import Shake


def build_techniques(
    settings: TrainSettings,
    pattern: Pattern,
    detectors: Sequence[Detector],
    device: torch.device,
    foreign: Sequence[Technique] = (),
) -> tuple[Techniques, Coloring]:
    """Build the techniques that the settings have on, `foreign` ones after them, and what makes colours with them.

    pattern: what has colours. InputError: a technique does not fit, or its file cannot be read.
    """
    colors, objective, surrogates = settings.pattern, settings.objective, settings.surrogates
    palette = None if objective.palette is None else read_palette(objective.palette)
    built: list[Technique] = []
    if colors.near is not None:
        garment = read_garment(settings, pattern)
        built.append(Near(garment, colors.within, 2 * colors.within))
    if palette is not None:
        built.append(Printability(objective.nps_weight, palette, device))
    if surrogates.shake:
        for detector in detectors:
            if detector.compiled:
                raise InputError(f"--detector {detector.spec}: compiled, so --shake does not reach into it")
        built.append(Shake(surrogates.shake, settings.run.seed))
    techniques = Techniques([*built, *foreign])
    inks = None
    if colors.colors_at_most is not None:
        fixed = None if palette is None else torch.as_tensor(palette, dtype=torch.float32, device=device)
        inks = Inks(colors.colors_at_most, fixed)
    profile = None if colors.profile is None else read_profile(colors.profile)
    return techniques, Coloring(settings.optimization, pattern, inks, profile, techniques, device)
