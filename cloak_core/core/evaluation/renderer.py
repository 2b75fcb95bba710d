"""What an evaluation asks of a source of views: the same images under every control."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import pandas as pd
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector.outcomes import OnBody
from cloak_core.core.detector.protocol import Detections
from cloak_core.core.view import BakedView

Indices = Sequence[int] | np.ndarray
"""Trials, or backgrounds, by number."""


@runtime_checkable
class EvaluationRenderer(Protocol):
    """What an evaluation needs of a source of views, whether rendered bodies or people in photographs.

    Measuring, statistics and reports ask for nothing else. What an image shows stands in the columns of `trials`.
    """

    trials: pd.DataFrame
    """A row per image: `trials.COLUMNS` as far as this source knows them, and columns of its own."""

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names by the number in the column `pose`; empty where trials have no such column."""

    @property
    def background_names(self) -> tuple[str, ...]:
        """Names by the number in the column `background`; those of `bare`."""

    def views(self, indices: Indices) -> list[BakedView]:
        """Make the views of these trials: faces, weights and a base image each."""

    def compose(
        self, views: Sequence[BakedView], indices: Indices, controls: Sequence[str]
    ) -> Iterator[Float[Tensor, "B 3 H W"]]:
        """Render these views in [0, 1] under one control after the other; each may reuse the memory of the last."""

    def boxes(self, views: Sequence[BakedView], indices: Indices) -> Float[Tensor, "B 4"]:
        """The true boxes that detectors' boxes are compared with: xyxy pixels, clipped to the image."""

    def about_person(self, detections: Detections, views: Sequence[BakedView], indices: Indices) -> Detections:
        """Set the scores of boxes to 0 that show somebody else than the trials' person, if anybody else is there."""

    def on_person(self, detections: Detections, views: Sequence[BakedView], indices: Indices) -> OnBody:
        """Find the best person score and the best other class on each trial's person."""

    def bare(self, backgrounds: Indices) -> Float[Tensor, "B 3 H W"]:
        """Images without a person, by the number of the background, for false alarms."""

    def flat_views(self) -> dict[str, Float[Tensor, "h w 4"]]:
        """Pictures of the trained colours alone by name, RGBA in [0, 1]; empty where there are none."""


def render_images(renderer: EvaluationRenderer, indices: Indices, control: str) -> Float[Tensor, "B 3 H W"]:
    """Render these trials, in [0, 1], with the logo's faces coloured as `control` says."""
    return next(renderer.compose(renderer.views(indices), indices, (control,)))
