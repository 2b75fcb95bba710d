"""Which body, angle, background and augmentation each training image gets.

Everything drawn is a function of (seed, step): a resumed run draws what the uninterrupted one drew, and each of several
processes can draw the whole batch and take its share.
"""

from dataclasses import dataclass

import numpy as np

from cloak_core.attack.settings import TrainSettings
from cloak_core.attack.settings.components import ViewSettings
from cloak_core.attack.settings.values import Range
from cloak_core.scene.cameras import Camera

_EPOCH, _STEP, _PEOPLE = 0, 1, 4
"""Streams of random numbers, kept apart."""


@dataclass(frozen=True)
class Draws:
    """What B images show; every field has length B."""

    background: np.ndarray
    """int64, index of the background."""
    pose: np.ndarray
    """int64, index of the pose."""
    outfit: np.ndarray
    """int64, index of the outfit."""
    sector: np.ndarray
    """int64, index of the training angle, or of the part of a range of angles."""
    azimuth: np.ndarray
    """float64, degrees."""
    elevation: np.ndarray
    """float64, degrees."""
    distance: np.ndarray
    """float64, metres."""
    shift: np.ndarray
    """[B, 2] int64, (dx, dy) pixels."""
    contrast: np.ndarray
    """float64 factors."""
    brightness: np.ndarray
    """float64 summands."""
    seed: np.ndarray
    """int64, for what else an image needs at random (noise, cutout)."""
    person: np.ndarray
    """int64, index of the person in a photograph who is shown instead of a body; -1: none, it is a render."""

    def __len__(self) -> int:
        return len(self.pose)

    def share(self, rank: int, count: int) -> "Draws":
        """Take every `count`-th image from `rank` on: one process's part of the batch."""
        return Draws(**{name: getattr(self, name)[rank::count] for name in self.__dataclass_fields__})


class Sampler:
    """Draws the batches of a run.

    An epoch shows every background once at every training angle, the bodies dealt out evenly (each shown as often as
    any other, plus or minus one), in random order. Batches run on across epochs; the run's last one may be shorter.
    """

    def __init__(
        self, settings: TrainSettings, pose_count: int, outfit_count: int, background_count: int, people_count: int = 0
    ) -> None:
        self.settings, self.people_count = settings, people_count
        self.pose_count, self.background_count = pose_count, background_count
        views = settings.views
        self.outfit_count = outfit_count if views.outfits == "random" else 1
        self.angles, self.sector_width = np.array(views.angles.starts), views.angles.width
        self.epoch_images = settings.epoch_images(background_count)
        self.steps = settings.total_steps(background_count)
        self.images = self.steps * settings.run.batch
        if settings.run.steps is None:
            self.images = min(self.images, max(1, round(settings.run.epochs * self.epoch_images)))
        self._plan: tuple[int, np.ndarray, np.ndarray, np.ndarray] | None = None

    def epoch_of(self, step: int) -> float:
        """Count the epochs finished before `step` (from 0)."""
        return step * self.settings.run.batch / self.epoch_images

    def images_of(self, step: int) -> int:
        """Count the images of `step`: a batch, or what is left at the end."""
        batch = self.settings.run.batch
        return min(batch, self.images - step * batch)

    def draw(self, step: int) -> Draws:
        """Draw the images of `step`, 0 <= step < steps."""
        views, augmentation, run = self.settings.views, self.settings.augmentation, self.settings.run
        images = step * run.batch + np.arange(self.images_of(step))
        background, pose, sector = self._deal(images)
        count = len(images)
        random = np.random.default_rng([run.seed, _STEP, step])
        far = augmentation.translation
        shift = random.integers(-far, far, (count, 2), endpoint=True)

        def spread(values: Range) -> np.ndarray:
            return random.uniform(values.low, values.high, count)

        jitter = spread(Range(-views.angle_jitter, views.angle_jitter))
        return Draws(
            background=background,
            pose=pose,
            outfit=random.integers(self.outfit_count, size=count),
            sector=sector,
            azimuth=self.angles[sector] + random.uniform(0, self.sector_width, count) + jitter,
            elevation=spread(views.elevation) + random.standard_normal(count) * views.elevation_jitter,
            distance=spread(views.distance),
            shift=shift if augmentation.translation_per == "image" else np.repeat(shift[:1], count, axis=0),
            contrast=spread(augmentation.contrast),
            brightness=spread(augmentation.brightness),
            seed=random.integers(2**62, size=count),
            person=self._people(step, images),
        )

    def _people(self, step: int, images: np.ndarray) -> np.ndarray:
        """Choose who is shown in each image: everybody equally often, in random order; -1 in the share of renders."""
        if not self.people_count:
            return np.full(len(images), -1)
        random = np.random.default_rng([self.settings.run.seed, _PEOPLE, step])
        rounds, places = np.divmod(images, self.people_count)
        orders = {r: np.random.default_rng([self.settings.run.seed, _PEOPLE, 0, r]) for r in np.unique(rounds).tolist()}
        orders = {r: order.permutation(self.people_count) for r, order in orders.items()}
        person = np.array([orders[r][p] for r, p in zip(rounds.tolist(), places.tolist(), strict=True)], np.int64)
        return np.where(random.random(len(images)) < self.settings.photographs.people_share, person, -1)

    def _deal(self, images: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Deal background, pose and angle index to images counted from the start of the run."""
        epochs, places = np.divmod(images, self.epoch_images)
        dealt = np.empty((3, len(images)), np.int64)
        for epoch in np.unique(epochs):
            chosen = epochs == epoch
            for row, plan in zip(dealt, self._epoch_plan(int(epoch)), strict=True):
                row[chosen] = plan[places[chosen]]
        return tuple(dealt)

    def _epoch_plan(self, epoch: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self._plan is None or self._plan[0] != epoch:
            random = np.random.default_rng([self.settings.run.seed, _EPOCH, epoch])
            background, angle = np.divmod(random.permutation(self.epoch_images), len(self.angles))
            # A new order of the bodies each epoch, so that the odd ones out change.
            pose = random.permutation(self.pose_count)[random.permutation(self.epoch_images) % self.pose_count]
            self._plan = (epoch, background, pose, angle)
        return self._plan[1:]


def cameras(draws: Draws, settings: ViewSettings) -> list[Camera]:
    """Make the B cameras of some draws. Equal draws give equal cameras, so that the ViewCache finds views again."""
    places = zip(draws.azimuth.tolist(), draws.elevation.tolist(), draws.distance.tolist(), strict=True)
    return [settings.camera(*place) for place in places]


def is_fresh(settings: ViewSettings) -> bool:
    """Tell whether every image has a camera of its own, so that caching views gains nothing."""
    spread = settings.angle_jitter, settings.elevation_jitter, settings.angles.width
    return any(spread) or settings.distance.width > 0 or settings.elevation.width > 0
