"""Render people in photographs in whatever they are dressed in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector.outcomes import HERS, OnBody, on_body, only_hers
from cloak_core.core.detector.protocol import Detections
from cloak_core.core.evaluation.controls import CLOTHING
from cloak_core.core.evaluation.renderer import Indices
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.paint import compose
from cloak_core.core.view import BakedView
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.photographs.fitting import Fit
from cloak_core.sources.photographs.posing import seen_from
from cloak_core.sources.photographs.rig import body_rig
from cloak_core.sources.photographs.views import framing_of, person_mask, photograph_view
from cloak_core.studies.wearing.clothes import Clothes, controls


class PeopleRenderer:
    """An `EvaluationRenderer` of fitted people in photographs; every control is something to wear."""

    def __init__(
        self,
        fits: Sequence[Fit],
        clothes: Sequence[Clothes],
        backgrounds: Backgrounds,
        settings: WearSettings,
        device: torch.device | str = "cpu",
    ) -> None:
        self.fits, self.settings, self._backgrounds, self._device = fits, settings, backgrounds, device
        self.clothes = {one.name: one for one in (*clothes, *controls())}
        people, rig = [fit.person for fit in fits], body_rig()
        self.trials = pd.DataFrame(
            {
                "pose": np.arange(len(fits)),
                "photograph": [person.photograph for person in people],
                "seen_from": [seen_from(person.landmarks, rig) for person in people],
            }
        )

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the people."""
        return tuple(fit.person.name for fit in self.fits)

    @property
    def background_names(self) -> tuple[str, ...]:
        """Names of the backgrounds without people."""
        return tuple(self._backgrounds.names)

    def views(self, indices: Indices) -> list[BakedView]:
        """The photographs as they are, no face laid anywhere, each with the person's mask."""
        return [self._photograph(int(i)) for i in indices]

    def _photograph(self, number: int) -> BakedView:
        fit, settings = self.fits[number], self.settings
        view, _ = dress(fit, self.clothes[CLOTHING], number, settings)
        return replace(view, mask=person_mask(fit, framing_of(fit, settings.context, settings.size)))

    def compose(
        self, views: Sequence[BakedView], indices: Indices, controls: Sequence[str]
    ) -> Iterator[Float[Tensor, "B 3 H W"]]:
        """Render these people in one clothes after the other."""
        for control in controls:
            if control == CLOTHING:
                worn = [(view, np.zeros((1, 3), np.float32)) for view in views]
            else:
                worn = [dress(self.fits[i], self.clothes[control], i, self.settings) for i in map(int, indices)]
            yield torch.stack([paint(view, colors) for view, colors in worn]).to(self._device)

    def boxes(self, views: Sequence[BakedView], indices: Indices) -> Float[Tensor, "B 4"]:
        """The people's own boxes: xyxy pixels."""
        return torch.tensor([view.box for view in views], dtype=torch.float32).to(self._device)

    def about_person(self, detections: Detections, views: Sequence[BakedView], indices: Indices) -> Detections:
        """Set the scores of boxes that are not the dressed person's to 0."""
        most = max(len(view.provenance["others"]) for view in views)
        others = torch.zeros(len(views), most, 4)
        for k, view in enumerate(views):
            others[k, : len(view.provenance["others"])] = torch.tensor(view.provenance["others"]).reshape(-1, 4)
        masks = torch.stack([view.mask for view in views]).to(self._device)
        return only_hers(detections, self.boxes(views, indices), others.to(detections.boxes), masks=masks)

    def on_person(self, detections: Detections, views: Sequence[BakedView], indices: Indices) -> OnBody:
        """Find the best scores of what `about_person` left: its person boxes are all hers."""
        return on_body(detections, self.boxes(views, indices), HERS, within=0.0)

    def bare(self, backgrounds: Indices) -> Float[Tensor, "B 3 H W"]:
        """Backgrounds without people, as large as the images."""
        size = self.settings.size
        return self._backgrounds.batch([int(i) for i in backgrounds], size, size).to(self._device)

    def flat_views(self) -> dict[str, Tensor]:
        """None: there is no body to show the colours on."""
        return {}


def dress(fit: Fit, worn: Clothes, number: int, settings: WearSettings) -> tuple[BakedView, Float[np.ndarray, "L 3"]]:
    """Lay clothes on one person: the view, and the colours that it takes."""
    shares, colors = worn.on(fit, number)
    return photograph_view(fit, shares, framing_of(fit, settings.context, settings.size)), colors


def paint(view: BakedView, colors: Float[np.ndarray, "L 3"]) -> Float[Tensor, "3 H W"]:
    """Render one view of a person in these colours, in [0, 1]."""
    behind = torch.zeros(1, 3, view.height, view.width)
    return compose([view], torch.from_numpy(np.ascontiguousarray(colors)), behind)[0]
