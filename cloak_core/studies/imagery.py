"""Sets of images of bodies before backgrounds, which are judged."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.cameras import Camera
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.trials import draw_trials
from cloak_core.core.images import ImageSet, dressed
from cloak_core.core.paint import blank
from cloak_core.core.pattern import Pattern
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.source import BodySource, check_topology

SIDES = {"front": 0.0, "left": 90.0, "back": 180.0, "right": 270.0}
"""Azimuths of the flat views, degrees; left and right are the body's own."""


def body_images(
    bodies: Bodies,
    backgrounds: Backgrounds,
    trials: pd.DataFrame,
    render: RenderSettings,
    viewpoint: Camera,
    patterns: Iterable[Pattern],
) -> ImageSet:
    """Make images of bodies before backgrounds; nothing but the shift of a trial moves one.

    viewpoint: the camera, but for azimuth, elevation and distance. patterns: all that are to be worn. InputError: one
    is another mesh's, or there is no background.
    """
    _require_some(backgrounds)
    patterns = [pattern for pattern in patterns if check_topology(pattern.cover, bodies)]
    source = BodySource(bodies, render, viewpoint, on_cloth=any(pattern.needs_cloth for pattern in patterns))
    size = viewpoint.height, viewpoint.width
    return ImageSet(source, backgrounds, size, render.device, trials, tuple(bodies.names), tuple(backgrounds.names))


def drawn_images(
    bodies: Bodies,
    backgrounds: Backgrounds,
    angles: Sequence[float],
    settings: EvaluateSettings,
    device: torch.device | str,
    patterns: Iterable[Pattern],
) -> ImageSet:
    """Draw the images of an evaluation of bodies. angles: azimuths, degrees. InputError: see `body_images`."""
    _require_some(backgrounds)
    trials = draw_trials(bodies.pose_count, angles, len(backgrounds), bodies.outfit_count, settings)
    render = RenderSettings.of(settings, device=device)
    return body_images(bodies, backgrounds, trials, render, settings.camera, patterns)


def _require_some(backgrounds: Backgrounds) -> None:
    if not len(backgrounds):
        raise InputError("no background to evaluate on")


def camera_of(images: ImageSet, trial: int) -> Camera:
    """Make the camera that a trial of bodies is seen by."""
    row = images.trials.iloc[trial]
    return images.source.camera({**row, "azimuth": row["angle"]})


def before_grey(
    view: BakedView, pattern: Pattern, grey: float = 0.5, trial: int = 0
) -> tuple[Float[Tensor, "3 H W"], Float[Tensor, " pixels"]]:
    """Render a view, unmoved, before one grey; also how much of every pixel it covers."""
    device = view.pixels.device
    rows = blank(1, view.height, view.width, device).fill_(grey)
    image = dressed([view], pattern, rows).paint(pattern.colors_in(view, trial))[0]
    coverage = torch.zeros(view.height * view.width, device=device)
    coverage[view.pixels] = view.coverage
    return image, coverage


def flat_views(
    bodies: Bodies, pattern: Pattern, size: int = 640, device: torch.device | str = "cpu"
) -> dict[str, Float[Tensor, "_ _ 4"]]:
    """Render the first body in a pattern under even light, from each side that shows any of it.

    RGBA in [0, 1], cut to the body; size: of the whole square, pixels.
    """
    render = RenderSettings(light=Light(ambient=1.0, diffuse=0.0, specular=0.0), device=device)
    source = BodySource(bodies.select_poses([0]), render, Camera(width=size, height=size))
    shown = {"pose": 0, "outfit": 0, "elevation": 0.0, "distance": source.viewpoint.distance}
    sides = {}
    for side, azimuth in SIDES.items():
        view = source.view(shown | {"azimuth": azimuth}, None, pattern)
        image, alpha = before_grey(view, pattern, 1.0)
        alpha = alpha.view(1, view.height, view.width)
        # Take the white behind the silhouette's pixels out again.
        color = ((image - (1 - alpha)) / alpha.clamp(min=1e-3)).clamp(0, 1)
        x0, y0, x1, y1 = view.box
        rgba = torch.cat([color, alpha])[:, y0:y1, x0:x1].permute(1, 2, 0)
        if rgba.numel():
            sides[side] = rgba
    return sides
