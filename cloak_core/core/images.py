"""Images of people and bodies in what they wear: what training draws and what judging looks at.

An image is paint(view.map @ pattern.map(view.places), colours, base, background), whoever makes the view and whatever
is worn; the base is `view.beside` what the pattern covers.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from cloak_core.core.detector import IOU
from cloak_core.core.detector.outcomes import OWN_IOU, OnBody, for_person, on_body
from cloak_core.core.detector.protocol import Detections
from cloak_core.core.paint import Canvas, blank, body_masks, lay_backdrop, pixels_of, true_boxes
from cloak_core.core.pattern import Pattern
from cloak_core.core.source import Backdrops, Source
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.threads import spread
from cloak_core.files.identity import sha256_arrays, sha256_record

Indices = Sequence[int] | np.ndarray
"""Images, or backgrounds, by number."""


def dressed(
    views: Sequence[BakedView],
    pattern: Pattern,
    rows: Float[Tensor, "P 3"],
    shifts: Int64[Tensor, "B 2"] | None = None,
) -> Canvas:
    """Put a pattern on B views before the backgrounds in `rows` (see `paint.blank`): a canvas that lacks colours."""
    worn = []
    for view in views:
        offset = (0.0, 0.0) if view.stream is None else pattern.draw_offset(np.random.default_rng(view.stream))
        worn.append(pattern.map(view.places, offset))
    beside = [view.beside(own) for view, own in zip(views, worn, strict=True)]
    maps = [view.map @ own for view, own in zip(views, worn, strict=True)]
    return Canvas.of(beside, rows, shifts, maps)


@dataclass(eq=False)
class ImageSet:
    """A source of views, backgrounds, and what N images show of them: a table of trials, or a plan's draws."""

    source: Source
    backgrounds: Backdrops
    size: tuple[int, int]
    """Height and width, pixels."""
    device: torch.device | str = "cpu"
    """Where images are made."""
    trials: pd.DataFrame = field(default_factory=pd.DataFrame)
    """A row per image that is judged: `evaluation.trials.COLUMNS` as far as the source knows them, and its own."""
    body_names: tuple[str, ...] = ()
    """By the number in the column `pose`."""
    background_names: tuple[str, ...] = ()
    """By the number in the column `background`; those of `bare`."""

    def __post_init__(self) -> None:
        self.device = torch.device(self.device)

    @property
    def identity(self) -> str | None:
        """SHA-256 (hex) of all that the images show beside what is worn; None where that is not known."""
        if self.source.identity is None:
            return None
        columns = {name: values.to_numpy() for name, values in self.trials.items()}
        plain = {name: values.astype(np.str_) if values.dtype == object else values for name, values in columns.items()}
        trials = {name: sha256_arrays(values) for name, values in plain.items()}
        return sha256_record([self.source.identity, trials, self.size, self.backgrounds.identities()])

    # --- what training and judging share

    def make_views(
        self, shown: Sequence[tuple[Mapping[str, int | float], int | None]], pattern: Pattern, threads: int = 1
    ) -> list[BakedView]:
        """Make the views of images from their columns and seeds."""
        return spread(lambda one: self.source.view(*one, pattern).to(self.device), shown, threads)

    def backdrop(self, views: Sequence[BakedView], backgrounds: Indices) -> Float[Tensor, "P 3"]:
        """Lay out the backgrounds behind views, as rows of a canvas; none behind a view that fills its image."""
        rows = blank(len(views), *self.size, self.device)
        # A drawn scene takes longer than its view.
        behind = [
            None if view.is_whole else self.backgrounds.image(int(number), self.size)
            for view, number in zip(views, backgrounds, strict=True)
        ]
        lay_backdrop(rows, behind, self.size)
        return rows

    # --- what is judged

    def views(self, indices: Indices, pattern: Pattern) -> list[BakedView]:
        """Make the views of these trials, with places on the faces that the pattern covers."""
        chosen = self.trials.iloc[np.asarray(indices, np.int64)]
        chosen = chosen.assign(azimuth=chosen.get("angle"), person=chosen["pose"])
        return self.make_views([(row, None) for row in chosen.to_dict("records")], pattern)

    def shifts(self, indices: Indices) -> Int64[Tensor, "B 2"] | None:
        """How far the bodies of these trials are moved, pixels right and down; None: not at all."""
        if "shift_x" not in self.trials:
            return None
        moved = self.trials[["shift_x", "shift_y"]].to_numpy(np.int64)[np.asarray(indices, np.int64)]
        return torch.from_numpy(moved).to(self.device)

    def render(self, indices: Indices, pattern: Pattern) -> Float[Tensor, "B 3 H W"]:
        """Render these trials in one pattern, in [0, 1]."""
        return next(self.compose(indices, [pattern]))

    def compose(self, indices: Indices, patterns: Sequence[Pattern]) -> Iterator[Float[Tensor, "B 3 H W"]]:
        """Render these trials in one pattern after the other, in [0, 1]; each may reuse the memory of the last."""
        made: dict[Hashable, list[BakedView]] = {}  # a source asks a pattern for no more than its faces, and for places
        last: tuple[Hashable, Canvas] | None = None
        background = self.trials.get("background", pd.Series(np.zeros(len(self.trials), np.int64))).to_numpy()
        for pattern in patterns:
            asked = pattern.cover.key, pattern.needs_cloth
            if asked not in made:
                made[asked] = self.views(indices, pattern)
            views = made[asked]
            colors = torch.stack([pattern.colors_in(view, int(i)) for view, i in zip(views, indices, strict=True)])
            layout = asked, pattern.layout, colors.shape[1]  # own clothes are faces of a body, and none of a photograph
            if last is None or last[0] != layout:
                rows = self.backdrop(views, background[np.asarray(indices, np.int64)])
                last = layout, dressed(views, pattern, rows, self.shifts(indices))
            yield last[1].paint(colors)

    def judged(self, detections: Detections, views: Sequence[BakedView], indices: Indices) -> tuple[Detections, OnBody]:
        """Keep what is said of each image's person, and find the best scores on them: of persons, of other classes.

        A person box counts where it fits the body; in a photograph also where it lies within the person, and boxes of
        other people do not count.
        """
        alone = torch.tensor([view.subject.is_alone for view in views], device=self.device)
        boxes = self.boxes(views, indices)
        is_company = not bool(alone.all())
        masks = body_masks(views, self.shifts(indices)) if is_company or detections.other is not None else None
        if is_company:
            detections = for_person(detections, boxes, other_boxes(views).to(detections.boxes), alone, masks)
        iou = torch.where(alone, IOU, OWN_IOU)[:, None]
        within = torch.where(alone, math.inf, 0.0)[:, None]
        return detections, on_body(detections, boxes, iou, within, masks)

    def boxes(self, views: Sequence[BakedView], indices: Indices) -> Float[Tensor, "B 4"]:
        """Give the true boxes that detectors' boxes are compared with: xyxy pixels, clipped to the image."""
        return true_boxes(views, self.shifts(indices)).to(self.device, torch.float32)

    def bare(self, backgrounds: Indices) -> Float[Tensor, "B 3 H W"]:
        """Make images without a person, by the number of the background, for false alarms."""
        rows = blank(len(backgrounds), *self.size, self.device)
        lay_backdrop(rows, [self.backgrounds.image(int(number), self.size) for number in backgrounds], self.size)
        return pixels_of(rows, (len(backgrounds), 3, *self.size))


def other_boxes(views: Sequence[BakedView]) -> Float[Tensor, "B K 4"]:
    """Collect the boxes of the other people in each image; zeros where there are fewer."""
    boxes = [view.subject.others for view in views]
    others = torch.zeros(len(views), max(map(len, boxes)), 4)
    for k, of_image in enumerate(boxes):
        others[k, : len(of_image)] = torch.tensor(of_image, dtype=torch.float32).reshape(-1, 4)
    return others


def is_alone(views: Sequence[BakedView]) -> Bool[Tensor, " B"]:
    """Tell in which images nobody else can be."""
    return torch.tensor([view.subject.is_alone for view in views])
