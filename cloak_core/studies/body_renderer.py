"""Render the images of an evaluation: the same view, background, shift and outfit under every control."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from cloak_core.core.baking import on_cloth
from cloak_core.core.cameras import Camera
from cloak_core.core.detector.outcomes import OnBody, on_body
from cloak_core.core.detector.protocol import Detections
from cloak_core.core.evaluation.controls import LOGO, control_colors, random_colors
from cloak_core.core.evaluation.renderer import Indices
from cloak_core.core.paint import Canvas, body_masks, compose, true_boxes
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.studies.cloaked import Cloaked

SIDES = {"front": 0.0, "left": 90.0, "back": 180.0, "right": 270.0}
"""Azimuths of the flat views, degrees; left and right are the body's own."""


@dataclass(eq=False)
class BodyRenderer:
    """An `EvaluationRenderer` of bodies before backgrounds, rasterized.

    Nothing but the shift of the trial moves an image: no contrast, brightness or noise is added.
    """

    cloaked: Cloaked
    trials: pd.DataFrame
    viewpoint: Camera
    """The camera, but for azimuth, elevation and distance."""
    view_cache: ViewCache
    seed: int = 0

    def __post_init__(self) -> None:
        self._device = torch.device(self.view_cache.device)
        self._controls: dict[str, Tensor] = {}

    def views(self, indices: Indices) -> list[BakedView]:
        """Return the baked view of each of these trials."""
        faces, (pose, outfit) = (
            self.cloaked.logo.face_ids,
            (self.trials[name].to_numpy() for name in ("pose", "outfit")),
        )
        return [self.view_cache.bake(int(pose[i]), self.camera(i), faces, int(outfit[i])) for i in map(int, indices)]

    def compose(
        self, views: Sequence[BakedView], indices: Indices, controls: Sequence[str]
    ) -> Iterator[Float[Tensor, "B 3 H W"]]:
        """Render these views under one control after the other.

        What no control changes is composed once, so the next images are drawn into the memory of these.
        """
        backgrounds = self.backgrounds(indices)
        shifts = self.shifts(indices)
        canvas = Canvas.before(views, backgrounds, shifts)
        for control in controls:
            colors = self._logo_colors(indices, control)
            if self._is_cloth(control):
                yield Canvas.before([self._worn(view, control) for view in views], backgrounds, shifts).paint(colors)
            else:
                yield canvas.paint(colors)

    def boxes(self, views: Sequence[BakedView], indices: Indices) -> Float[Tensor, "B 4"]:
        """Where the rendered bodies are: xyxy pixels, clipped to the image."""
        return true_boxes(views, self.shifts(indices)).to(self._device, torch.float32)

    def about_person(self, detections: Detections, views: Sequence[BakedView], indices: Indices) -> Detections:
        """Return the detections as they are: nobody else is in these images."""
        return detections

    def on_person(self, detections: Detections, views: Sequence[BakedView], indices: Indices) -> OnBody:
        """Find the best scores: of persons that overlap the body with IoU >= 0.5, of other classes anywhere on it."""
        masks = None if detections.other is None else body_masks(views, self.shifts(indices))
        return on_body(detections, self.boxes(views, indices), within=math.inf, masks=masks)

    def before_grey(
        self, view: BakedView, index: int, control: str
    ) -> tuple[Float[Tensor, "3 H W"], Float[Tensor, " pixels"]]:
        """Render one trial's body, unmoved, before mid-grey; also how much of every pixel it covers."""
        grey = torch.full((1, 3, view.height, view.width), 0.5, device=self._device)
        image = compose([self._worn(view, control)], self._logo_colors([index], control), grey)[0]
        coverage = torch.zeros(view.height * view.width, device=self._device)
        coverage[view.pixels] = view.coverage
        return image, coverage

    def flat_views(self, size: int = 640) -> dict[str, Float[Tensor, "_ _ 4"]]:
        """Render the first body in the trained colours under even light, from each side that shows any of it.

        RGBA in [0, 1], cut to the body; size: of the whole square, pixels.
        """
        views = {side: self._flat_view(azimuth, size) for side, azimuth in SIDES.items()}
        return {side: rgba for side, rgba in views.items() if rgba.numel()}

    def _flat_view(self, azimuth: float, side: int) -> Float[Tensor, "h w 4"]:
        flat = Light(ambient=1.0, diffuse=0.0, specular=0.0)
        first = self.cloaked.bodies.select_poses([0])
        settings = RenderSettings(light=flat, device=self._device)
        view_cache = ViewCache(first, settings, on_cloth=self.cloaked.cloth is not None)
        camera = Camera(elevation=0.0, azimuth=azimuth, width=side, height=side)
        view = view_cache.bake(0, camera, self.cloaked.logo.face_ids)
        white = torch.ones(1, 3, side, side, device=self._device)
        image = compose([self._worn(view, LOGO)], self._colors_of(LOGO)[0], white)[0]
        alpha = torch.zeros(side * side, device=self._device)
        alpha[view.pixels] = view.coverage
        alpha = alpha.view(1, side, side)
        # Take the white behind the silhouette's pixels out again.
        color = ((image - (1 - alpha)) / alpha.clamp(min=1e-3)).clamp(0, 1)
        x0, y0, x1, y1 = view.box
        return torch.cat([color, alpha])[:, y0:y1, x0:x1].permute(1, 2, 0)

    def camera(self, index: int) -> Camera:
        """Return the camera of a trial."""
        distance, azimuth, elevation = (float(self.trials.at[index, x]) for x in ("distance", "angle", "elevation"))
        return replace(self.viewpoint, distance=distance, azimuth=azimuth, elevation=elevation)

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies, by pose."""
        return tuple(self.cloaked.bodies.names)

    @property
    def background_names(self) -> tuple[str, ...]:
        """Names of the backgrounds, by index."""
        return tuple(self.cloaked.backgrounds.names)

    def bare(self, backgrounds: Indices) -> Float[Tensor, "B 3 H W"]:
        """Backgrounds by their own index, with nobody in front."""
        numbers = [int(i) for i in backgrounds]
        size = (self.viewpoint.height, self.viewpoint.width)
        return self.cloaked.backgrounds.batch(numbers, *size).to(self._device)

    def backgrounds(self, indices: Indices) -> Float[Tensor, "B 3 H W"]:
        """Return the backgrounds of these trials."""
        return self.bare(self.trials["background"].to_numpy()[np.asarray(indices, np.int64)])

    def shifts(self, indices: Indices) -> Int64[Tensor, "B 2"]:
        """Return how far the bodies of these trials are moved: pixels right and down."""
        moved = self.trials[["shift_x", "shift_y"]].to_numpy(np.int64)[np.asarray(indices, np.int64)]
        return torch.from_numpy(moved).to(self._device)

    def _is_cloth(self, control: str) -> bool:
        return control == LOGO and self.cloaked.cloth is not None

    def _worn(self, view: BakedView, control: str) -> BakedView:
        """Put on what a control wears: a cloth in its own fineness, everything else face by face."""
        return on_cloth(view, self.cloaked.cloth.cloth) if self._is_cloth(control) else view

    def _logo_colors(self, indices: Indices, control: str) -> Float[Tensor, "B L 3"]:
        if control == "random":
            drawn = [random_colors(self.seed, int(i), len(self.cloaked.colors)) for i in indices]
            return torch.from_numpy(np.stack(drawn)).to(self._device)
        outfits = self.trials["outfit"].to_numpy()[np.asarray(indices, np.int64)]
        return self._colors_of(control)[torch.from_numpy(outfits).to(self._device)]

    def _colors_of(self, control: str) -> Float[Tensor, "K L 3"]:
        if control not in self._controls:
            worn = self.cloaked
            if self._is_cloth(control):
                colors = np.broadcast_to(worn.cloth.colors, (worn.bodies.outfit_count, *worn.cloth.colors.shape))
            else:
                colors = control_colors(control, worn.colors, worn.bodies, worn.logo.face_ids)
            self._controls[control] = torch.from_numpy(np.ascontiguousarray(colors)).to(self._device)
        return self._controls[control]
