"""Render dressed people, and measure what each detector says of every person under every clothes and control."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors.outcomes import HERS, OnBody, on_body, only_hers
from cloak_core.detectors.protocol import Detections, Detector
from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.measure import OnProgress, measure
from cloak_core.evaluation.renderer import Indices
from cloak_core.evaluation.results import CORNERS, Results
from cloak_core.evaluation.wearing.clothes import Clothes, clothes_position, controls
from cloak_core.evaluation.wearing.settings import WearSettings
from cloak_core.render.compositing import compose
from cloak_core.render.photographs.fitting import Fit
from cloak_core.render.photographs.views import framing_of, person_mask, photograph_view, shares_of
from cloak_core.render.types import BakedView
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.photographs.posing import seen_from
from cloak_core.scene.photographs.rig import body_rig


@dataclass(frozen=True, eq=False)
class Shot:
    """One judged image."""

    name: str
    """Of the clothes."""
    person: int
    image: Float[Tensor, "3 H W"]
    boxes: dict[str, np.ndarray]
    """For each detector, the boxes [n, 5] that count as hers above its own threshold, best first."""


def judge_people(
    fits: Sequence[Fit],
    clothes: Sequence[Clothes],
    detectors: Mapping[str, Detector],
    backgrounds: Backgrounds,
    settings: WearSettings,
    on_progress: OnProgress | None = None,
    on_shot: Callable[[Shot], None] | None = None,
) -> Results:
    """Dress every fitted person in everything, and ask every detector; also about backgrounds without people.

    The controls of the results are the clothes, then `CLOTHING` and the other controls. on_shot: takes every image as
    it was judged.
    """
    renderer = PeopleRenderer(fits, clothes, backgrounds, settings, next(iter(detectors.values())).device)

    def show(control: str, people: np.ndarray, images: Tensor, boxes: pd.DataFrame) -> None:
        for person, image in zip(people, images, strict=True):
            mine = boxes[(boxes["image"] == person).to_numpy()]
            found = {}
            for d, (spec, detector) in enumerate(detectors.items()):
                above = ((mine["detector"] == d) & (mine["score"] > detector.operating_point)).to_numpy()
                found[spec] = mine.loc[above, [*CORNERS, "score"]].to_numpy()
            on_shot(Shot(control, int(person), image.cpu(), found))

    bare = np.arange(min(settings.bare, len(backgrounds)))
    told = {"on_progress": on_progress, "on_images": None if on_shot is None else show}
    return measure(renderer, detectors, tuple(renderer.clothes), bare, batch=settings.batch, **told)


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
        self.clothes = {one.name: one for one in (*clothes, OwnPhotograph(), *controls())}
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


@dataclass(frozen=True, eq=False)
class OwnPhotograph:
    """The photograph as it is."""

    name: str = CLOTHING

    def on(self, fit: Fit, number: int) -> tuple[object, np.ndarray]:
        """See `Clothes`: no face is laid anywhere."""
        nothing = np.full(len(clothes_position()), -1)
        return shares_of(fit, nothing, 1), np.zeros((1, 3), np.float32)


def dress(
    fit: Fit, worn: Clothes | OwnPhotograph, number: int, settings: WearSettings
) -> tuple[BakedView, Float[np.ndarray, "L 3"]]:
    """Lay clothes on one person: the view, and the colours that it takes."""
    shares, colors = worn.on(fit, number)
    return photograph_view(fit, shares, framing_of(fit, settings.context, settings.size)), colors


def paint(view: BakedView, colors: Float[np.ndarray, "L 3"]) -> Float[Tensor, "3 H W"]:
    """Render one view of a person in these colours, in [0, 1]."""
    behind = torch.zeros(1, 3, view.height, view.width)
    return compose([view], torch.from_numpy(np.ascontiguousarray(colors)), behind)[0]
