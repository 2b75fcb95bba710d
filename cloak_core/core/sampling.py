"""Which background, view and augmentation each training image gets.

Everything drawn is a function of (seed, step): a resumed run draws what the uninterrupted one drew, and each of several
processes can draw the whole batch and take its share.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cloak_core.core.settings import TrainSettings
from cloak_core.core.settings.values import Range
from cloak_core.core.source import Dealt, Plan

_EPOCH, _STEP = 0, 1
"""Streams of random numbers, kept apart."""


@dataclass(frozen=True)
class Draws:
    """What B images show; every column has length B."""

    background: np.ndarray
    """int64, index of the background."""
    shift: np.ndarray
    """[B, 2] int64, (dx, dy) pixels."""
    contrast: np.ndarray
    """float64 factors."""
    brightness: np.ndarray
    """float64 summands."""
    seed: np.ndarray
    """int64, for what else an image needs at random (noise, cutout)."""
    shown: Mapping[str, np.ndarray]
    """The source's own columns."""

    def __len__(self) -> int:
        return len(self.seed)

    def rank_slice(self, rank: int, count: int) -> Draws:
        """Take every `count`-th image from `rank` on: one process's part of the batch."""
        part = slice(rank, None, count)
        own = {name: getattr(self, name)[part] for name in ("background", "shift", "contrast", "brightness", "seed")}
        return Draws(**own, shown={name: column[part] for name, column in self.shown.items()})

    def views(self) -> list[tuple[dict[str, int | float], int]]:
        """List each image's columns of the source, and its seed."""
        columns = {name: column.tolist() for name, column in self.shown.items()}
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        return list(zip(rows, self.seed.tolist(), strict=True))


class Sampler:
    """Draws the batches of a run.

    An epoch shows every background once in every direction, the members dealt out evenly (each shown as often as any
    other, plus or minus one), in random order. Batches run on across epochs; the run's last one may be shorter.
    """

    def __init__(self, settings: TrainSettings, source: Plan, background_count: int) -> None:
        self.settings = settings
        self.source = source
        self.background_count = background_count
        self.epoch_images = settings.epoch_images(background_count)
        self.steps = settings.total_steps(background_count)
        self.images = self.steps * settings.run.batch
        if settings.run.steps is None:
            self.images = min(self.images, max(1, round(settings.run.epochs * self.epoch_images)))
        self._plan: tuple[int, np.ndarray, np.ndarray, np.ndarray] | None = None

    def images_of(self, step: int) -> int:
        """Count the images of `step`: a batch, or what is left at the end."""
        batch = self.settings.run.batch
        return min(batch, self.images - step * batch)

    def draw(self, step: int) -> Draws:
        """Draw the images of `step`, 0 <= step < steps."""
        augmentation, run = self.settings.augmentation, self.settings.run
        images = step * run.batch + np.arange(self.images_of(step))
        background, member, direction = self._deal(images)
        count = len(images)
        random = np.random.default_rng([run.seed, _STEP, step])
        far = augmentation.translation
        shift = random.integers(-far, far, (count, 2), endpoint=True)
        shown = self.source.draw(Dealt(step, images, member, direction), random)
        return Draws(
            background=background,
            shift=shift if augmentation.translation_per == "image" else np.repeat(shift[:1], count, axis=0),
            contrast=_spread(random, augmentation.contrast, count),
            brightness=_spread(random, augmentation.brightness, count),
            seed=random.integers(2**62, size=count),
            shown=shown,
        )

    def _deal(self, images: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Deal background, member and direction to images counted from the start of the run."""
        epochs, places = np.divmod(images, self.epoch_images)
        dealt = np.empty((3, len(images)), np.int64)
        for epoch in np.unique(epochs).tolist():
            if self._plan is None or self._plan[0] != epoch:
                random = np.random.default_rng([self.settings.run.seed, _EPOCH, epoch])
                background, direction = np.divmod(random.permutation(self.epoch_images), self.source.directions)
                # A new order of the members each epoch, so that the odd ones out change.
                count = self.source.members
                member = random.permutation(count)[random.permutation(self.epoch_images) % count]
                self._plan = (epoch, background, member, direction)
            chosen = epochs == epoch
            for row, plan in zip(dealt, self._plan[1:], strict=True):
                row[chosen] = plan[places[chosen]]
        return tuple(dealt)


def _spread(random: np.random.Generator, values: Range, count: int) -> np.ndarray:
    return random.uniform(values.low, values.high, count)
