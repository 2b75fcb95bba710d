"""Renders the images of an evaluation: the same view, background, shift and outfit under every control."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from cloak_core.evaluation.controls import LOGO, control_colors, random_colors
from cloak_core.evaluation.measurement import Trials
from cloak_core.exchange.bodies import Bodies
from cloak_core.render.images.compositing import Canvas, compose, true_boxes
from cloak_core.render.images.dressing import DressedView
from cloak_core.render.views import ViewBank
from cloak_core.render.weights.shading import Light
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.cameras import Camera
from cloak_core.scene.logos.logo import Logo

Indices = Sequence[int] | np.ndarray
"""Which trials, by number."""


@dataclass(eq=False)
class Stage:
    """Trained colours, bodies and backgrounds, ready to render any trial under any control.

    Nothing but the shift of the trial moves an image: no contrast, brightness or noise is added.
    """

    colors: Float32[np.ndarray, "L 3"]
    logo: Logo
    bodies: Bodies
    backdrops: Backgrounds
    trials: Trials
    viewpoint: Camera
    """The camera, but for azimuth, elevation and distance."""
    bank: ViewBank
    seed: int = 0

    def __post_init__(self) -> None:
        self._device = torch.device(self.bank.device)
        self._controls: dict[str, Tensor] = {}

    def images(self, indices: Indices, control: str) -> Float[Tensor, "B 3 H W"]:
        """The images of these trials, in [0, 1], with the logo's faces coloured as `control` says."""
        return next(self.compose(self.views(indices), indices, (control,)))

    def views(self, indices: Indices) -> list[DressedView]:
        """The dressed view of each of these trials."""
        faces, trials = self.logo.face_ids, self.trials
        return [
            self.bank.dress(int(trials.pose[i]), self.camera(i), faces, int(trials.outfit[i]))
            for i in map(int, indices)
        ]

    def compose(
        self, views: Sequence[DressedView], indices: Indices, controls: Sequence[str]
    ) -> Iterator[Float[Tensor, "B 3 H W"]]:
        """`images` on views that are there already, under one control after the other.

        What no control changes is composed once, so the next images are drawn into the memory of these.
        """
        canvas = Canvas.before(views, self.backgrounds(indices), self.shifts(indices))
        for control in controls:
            yield canvas.paint(self._logo_colors(indices, control))

    def boxes(self, views: list, indices: Indices) -> Float[Tensor, "B 4"]:
        """Where the rendered bodies are: xyxy pixels, clipped to the image."""
        return true_boxes(views, self.shifts(indices)).to(self._device, torch.float32)

    def before_grey(
        self, view: DressedView, index: int, control: str
    ) -> tuple[Float[Tensor, "3 H W"], Float[Tensor, " pixels"]]:
        """One trial's body, unmoved, before mid-grey, and how much of every pixel it covers."""
        grey = torch.full((1, 3, view.height, view.width), 0.5, device=self._device)
        image = compose([view], self._logo_colors([index], control), grey, None, None)[0]
        coverage = torch.zeros(view.height * view.width, device=self._device)
        coverage[view.pixels] = view.coverage
        return image, coverage

    def flat_view(self, azimuth: float, side: int = 640) -> Float[Tensor, "h w 4"]:
        """The first body with the trained colours under even light, RGBA in [0, 1], cut to the body."""
        flat = Light(ambient=1.0, diffuse=0.0, specular=0.0)
        bank = ViewBank(self.bodies.select_poses([0]), flat, device=self._device)
        camera = Camera(elevation=0.0, azimuth=azimuth, width=side, height=side)
        view = bank.dress(0, camera, self.logo.face_ids)
        white = torch.ones(1, 3, side, side, device=self._device)
        image = compose([view], self._colors_of(LOGO)[0], white, None, None)[0]
        alpha = torch.zeros(side * side, device=self._device)
        alpha[view.pixels] = view.coverage
        alpha = alpha.view(1, side, side)
        # Take the white behind the silhouette's pixels out again.
        color = ((image - (1 - alpha)) / alpha.clamp(min=1e-3)).clamp(0, 1)
        x0, y0, x1, y1 = view.box
        return torch.cat([color, alpha])[:, y0:y1, x0:x1].permute(1, 2, 0)

    def camera(self, index: int) -> Camera:
        """The camera of a trial."""
        trials = self.trials
        distance, azimuth, elevation = (float(x[index]) for x in (trials.distance, trials.angle, trials.elevation))
        return replace(self.viewpoint, distance=distance, azimuth=azimuth, elevation=elevation)

    @property
    def background_names(self) -> tuple[str, ...]:
        """Names of the backgrounds, by index."""
        return tuple(self.backdrops.names)

    def bare(self, backgrounds: Indices) -> Float[Tensor, "B 3 H W"]:
        """Backgrounds by their own index, with nobody in front."""
        numbers = [int(i) for i in backgrounds]
        return self.backdrops.batch(numbers, self.viewpoint.height, self.viewpoint.width).to(self._device)

    def backgrounds(self, indices: Indices) -> Float[Tensor, "B 3 H W"]:
        """What is behind the bodies of these trials."""
        return self.bare([int(self.trials.background[i]) for i in indices])

    def shifts(self, indices: Indices) -> Tensor:
        """[B, 2] pixels right and down."""
        return torch.from_numpy(self.trials.shift[np.asarray(indices, np.int64)]).to(self._device)

    def _logo_colors(self, indices: Indices, control: str) -> Float[Tensor, "B L 3"]:
        if control == "random":
            drawn = [random_colors(self.seed, int(i), len(self.colors)) for i in indices]
            return torch.from_numpy(np.stack(drawn)).to(self._device)
        outfits = self.trials.outfit[np.asarray(indices, np.int64)]
        return self._colors_of(control)[torch.from_numpy(outfits).to(self._device)]

    def _colors_of(self, control: str) -> Float[Tensor, "K L 3"]:
        if control not in self._controls:
            colors = control_colors(control, self.colors, self.bodies, self.logo.face_ids)
            self._controls[control] = torch.from_numpy(np.ascontiguousarray(colors)).to(self._device)
        return self._controls[control]
