"""Which body, angle, background and augmentation each training image gets.

Everything drawn is a function of (seed, step), and with hard views of what earlier steps found: a resumed run draws
what the uninterrupted one drew, and each of several processes can draw the whole batch and take its share.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from cloak_core.core.cameras import Camera
from cloak_core.core.settings import TrainSettings
from cloak_core.core.settings.components import ViewSettings
from cloak_core.core.settings.values import Range

EVERY = 20
"""Steps that share their chances."""
MEMORY = 0.7
"""Weight of what was known of a view when it is seen again."""
LEAST = 0.02
"""Added to every view's mean, so that none is forgotten."""
_STATE = "hard_views."


class HardViews:
    """Chances of P poses x A azimuths: views in which a person is still found are drawn more often.

    A running mean of how surely a person is found is kept for every pose at every azimuth. Every `EVERY` steps new
    chances are worked out from it for the next block of steps, two steps before that block begins: a batch is built
    while the detector still works on the one before. So a step's draws depend on finished steps alone, and a resumed
    run, or one in several processes, draws the same.
    """

    def __init__(self, poses: int, azimuths: int) -> None:
        # Nothing known: as hard as can be, until it was seen.
        self._mean = np.ones((poses, azimuths))
        self._chances: dict[int, np.ndarray] = {}

    def draw(self, step: int, random: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Pose and azimuth index, [count] int64 each, of images of `step`."""
        azimuths = self._mean.shape[1]
        chances = self._chances.get(step // EVERY)
        total = np.ones(self._mean.size) if chances is None else chances.ravel()
        ladder = np.cumsum(total)
        cell = np.searchsorted(ladder, random.random(count) * ladder[-1], side="right")
        return np.divmod(np.minimum(cell, len(ladder) - 1), azimuths)

    def observe(
        self, step: int, pose: Int[np.ndarray, "B"], azimuth: Int[np.ndarray, "B"], found: Float[np.ndarray, "B"]
    ) -> None:
        """Note how surely a person was found, 0..1, in each image of `step`. In every process for the whole batch."""
        for p, a, value in zip(pose, azimuth, found, strict=True):
            self._mean[p, a] = MEMORY * self._mean[p, a] + (1 - MEMORY) * value
        if (step + 2) % EVERY == 0:
            block = (step + 2) // EVERY
            self._chances = {k: v for k, v in self._chances.items() if k == block - 1}
            self._chances[block] = self._mean + LEAST

    def state(self) -> dict[str, Tensor]:
        """Give the state for a checkpoint."""
        blocks = sorted(self._chances)
        kept = np.stack([self._chances[block] for block in blocks]) if blocks else np.empty((0, *self._mean.shape))
        return {
            _STATE + "mean": torch.from_numpy(self._mean.copy()),
            _STATE + "blocks": torch.tensor(blocks, dtype=torch.int64),
            _STATE + "chances": torch.from_numpy(kept),
        }

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state()`. KeyError or ValueError where the tensors belong to another run."""
        mean, blocks, chances = (tensors[_STATE + name].cpu().numpy() for name in ("mean", "blocks", "chances"))
        if mean.shape != self._mean.shape or chances.shape != (len(blocks), *mean.shape):
            raise ValueError("the hard views are those of other poses or angles")
        self._mean = mean.copy()
        self._chances = dict(zip(blocks.tolist(), chances.copy(), strict=True))


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
    """int64, for what else an image needs at random (noise, occluders)."""
    zoom: np.ndarray
    """float64 factors."""
    blur: np.ndarray
    """float64, standard deviations in pixels."""
    quality: np.ndarray
    """float64, of JPEG."""
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
        self.hard_views = HardViews(pose_count, len(self.angles)) if views.hard_views else None
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
        draws = Draws(
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
            zoom=spread(augmentation.zoom),
            blur=random.uniform(0, augmentation.blur, count),
            quality=spread(augmentation.jpeg or Range(100.0, 100.0)),
            person=self._people(step, images),
        )
        return draws if self.hard_views is None else self._harden(draws, step, random)

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

    def _harden(self, draws: Draws, step: int, random: np.random.Generator) -> Draws:
        """Give some images other poses and angles: those in which a person is still found."""
        chosen = random.random(len(draws)) < self.settings.views.hard_views
        drawn = self.hard_views.draw(step, random, len(draws))
        pose, sector = (np.where(chosen, *pair) for pair in zip(drawn, (draws.pose, draws.sector), strict=True))
        turn = self.angles[sector] - self.angles[draws.sector]
        return replace(draws, pose=pose, sector=sector, azimuth=draws.azimuth + turn)

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
