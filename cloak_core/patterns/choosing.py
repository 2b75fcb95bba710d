"""From settings to the pattern that is trained."""

from __future__ import annotations

from cloak_core.core.logo import Logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings.components import PatternSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.patterns.faces import FacePattern
from cloak_core.patterns.groups import GroupPattern


def pattern_of(settings: PatternSettings, bodies: Bodies, logo: Logo) -> Pattern:
    """Lay what the settings ask for onto a logo."""
    if settings.pattern == "tile":
        grid = Grid.of(settings.tile_cm / 100, settings.feature_cm / 100)
        return ClothPattern(logo, grid, bodies=bodies)
    if settings.pattern == "camouflage":
        return GroupPattern.of(bodies, logo, settings.feature_cm / 100)
    return FacePattern(logo, bodies)
