"""The optional techniques of training, a file each. Their settings stand in `core.settings.components`."""

from __future__ import annotations

import importlib
from collections.abc import Sequence

import torch

from cloak_core.core.coloring import Coloring, Inks
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings import TrainSettings
from cloak_core.core.technique import Technique, Techniques
from cloak_core.exchange.profiles import read_profile


def build_techniques(
    settings: TrainSettings,
    pattern: Pattern,
    detectors: Sequence[Detector],
    device: torch.device,
    foreign: Sequence[Technique] = (),
) -> tuple[Techniques, Coloring]:
    """Build the techniques that the settings have on, `foreign` ones after them, and what makes colours with them.

    Each file of this folder has `build(settings, pattern, detectors, device)`, and is imported only where it is on.
    pattern: what has colours. InputError: a technique does not fit, or its file cannot be read.
    """
    colors = settings.pattern
    is_on = {
        "near": colors.near is not None,
        "printability": settings.objective.palette is not None,
        "shake": settings.surrogates.shake > 0,
    }
    built = {
        name: importlib.import_module(f"cloak_core.techniques.{name}").build(settings, pattern, detectors, device)
        for name in is_on
        if is_on[name]
    }
    techniques = Techniques([*built.values(), *foreign])
    inks = None
    if colors.colors_at_most is not None:
        inks = Inks(colors.colors_at_most, built["printability"].palette if "printability" in built else None)
    profile = None if colors.profile is None else read_profile(colors.profile)
    return techniques, Coloring(settings.optimization, pattern, inks, profile, techniques, device)
