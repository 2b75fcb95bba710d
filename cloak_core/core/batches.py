"""From draws to what compositing takes: views of dressed bodies, backgrounds, shifts, photometric changes."""

import os
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from cloak_core.core.distortions import Distortion, cut_out
from cloak_core.core.images import ImageSet, dressed, is_alone, other_boxes
from cloak_core.core.paint import Canvas, true_boxes
from cloak_core.core.pattern import Pattern
from cloak_core.core.sampling import Draws, Sampler
from cloak_core.core.settings import TrainSettings
from cloak_core.core.settings.components import AugmentationSettings
from cloak_core.core.settings.values import Range
from cloak_core.core.source import Backdrops
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.threads import MOST_WORKERS, torch_threads, workers


@dataclass(frozen=True)
class Batch:
    """B images that lack nothing but the logo's colours."""

    empty: Float[Tensor, "0 3 H W"]
    """What there is to see where a short batch left this process no image."""
    canvas: Canvas | None
    """None there."""
    on_logo: "LogoChange | None"
    distortion: Distortion
    hidden: Bool[Tensor, "B L"] | None = None
    """Faces of the logo that are grey in an image; None: none."""
    bodies: Float[Tensor, "B 4"] | None = None
    """Each image's true box of the body, xyxy, pixels, as `images` shows it; None where there is no image."""
    company: "Company | None" = None
    """Who else is in the images; None: nobody in any of them."""

    def __len__(self) -> int:
        return self.canvas.shape[0] if self.canvas else 0

    def images(self, colors: Float[Tensor, "*B L 3"]) -> Float[Tensor, "B 3 H W"]:
        """Paint the colours (all images', or each image's own) into the images, in [0, 1], differentiably.

        The next call draws into the same memory.
        """
        if self.canvas is None:
            return self.empty + 0 * colors.sum()
        shown = colors if self.on_logo is None else self.on_logo(colors)
        if self.hidden is not None:
            shown = torch.where(self.hidden[..., None], 0.5, shown)
        return self.distortion(self.canvas.paint(shown))


@dataclass(frozen=True)
class Company:
    """The other people in each of B images; only photographs show any."""

    others: Float[Tensor, "B K 4"]
    """Their boxes as the images show them; zeros where there are fewer."""
    anywhere: Bool[Tensor, " B"]
    """Renders: nobody else can be in them, so that every box counts."""

    @staticmethod
    def of(views: Sequence[BakedView], distorted: Distortion, device: torch.device) -> "Company":
        """Collect the other people of views, where the distorted images show them."""
        others = other_boxes(views).to(device)
        moved = [distorted.boxes(others[:, k], views[0].height, views[0].width) for k in range(others.shape[1])]
        return Company(torch.stack(moved, dim=1) if moved else others, is_alone(views).to(device))

    def part(self, rows: slice | Int64[Tensor, " N"]) -> "Company":
        """Take the company of some of the images."""
        return Company(self.others[rows], self.anywhere[rows])


class Batcher:
    """Builds the batch of any step."""

    def __init__(
        self,
        settings: TrainSettings,
        sampler: Sampler,
        backgrounds: Backdrops,
        pattern: Pattern,
        device: torch.device,
    ) -> None:
        """Make what builds batches of the sampler's draws."""
        self.sampler = sampler
        self.augmentation = settings.augmentation
        self.size = settings.views.size
        self.images = ImageSet(sampler.source, backgrounds, (self.size, self.size), device)
        self.pattern = pattern
        self.device = device

    def batch(self, step: int, rank: int = 0, ranks: int = 1) -> Batch:
        """Build the images of `step`, or one process's part of them."""
        draws = self.sampler.draw(step).rank_slice(rank, ranks)
        settings, size = self.augmentation, self.size
        empty = torch.empty(0, 3, size, size, device=self.device)
        if not len(draws):
            return Batch(empty, None, None, Distortion())
        views = self.images.make_views(draws.views(), self.pattern, self._workers())
        rows = self.images.backdrop(views, draws.background)
        # A photograph is moved by the part of it that is shown.
        alone = is_alone(views)
        shifts = torch.where(alone[:, None], torch.from_numpy(draws.shift), 0).to(self.device, non_blocking=True)
        distorted = Distortion.draw(draws.seed, settings, self.device)
        hidden = cut_out(draws.seed, settings.cutout, self.pattern.centres) if settings.cutout else None
        return Batch(
            empty,
            dressed(views, self.pattern, rows, shifts),
            LogoChange.draw(draws, settings, self.pattern.count, self.device),
            distorted,
            None if hidden is None else torch.from_numpy(hidden).to(self.device),
            distorted.boxes(true_boxes(views, shifts), size, size),
            None if alone.all() else Company.of(views, distorted, self.device),
        )

    def _workers(self) -> int:
        """Choose how many threads make views. Threads that only look views up, or start a GPU's work, would wait for
        each other; a GPU that trains leaves the cores to those who make views on the CPU."""
        source = self.sampler.source
        if not source.is_fresh or source.works_on.type != "cpu":
            return 1
        return workers(source.works_on) if self.device.type == "cpu" else min(_cores(), MOST_WORKERS)


class Prefetcher:
    """A batcher that, where it gains time, builds the next batch in a thread while the detector is busy with this one.

    What a batch holds depends on its step alone, so that looking ahead changes nothing but time.
    """

    def __init__(self, batcher: Batcher, rank: int = 0, ranks: int = 1) -> None:
        self._batcher = batcher
        self._rank = rank
        self._ranks = ranks
        self._pool: ThreadPoolExecutor | None = None
        if looks_ahead(batcher.device):
            # On one CPU thread: a second team of threads would fight the detector's for the cores.
            self._pool = ThreadPoolExecutor(1, "batches", torch.set_num_threads, (1,))
        self._next: tuple[int, Future] | None = None

    def batch(self, step: int) -> Batch:
        """Give the batch of `step`; begin that of `step + 1`."""
        expected = self._next is not None and self._next[0] == step
        ready = self._next[1].result() if expected else self._batcher.batch(step, self._rank, self._ranks)
        if self._pool is not None and step + 1 < self._batcher.sampler.steps:
            self._next = (step + 1, self._pool.submit(self._batcher.batch, step + 1, self._rank, self._ranks))
        return ready

    def finish(self) -> None:
        """Wait until the batch that was begun is there."""
        if self._next is not None:
            self._next[1].exception()

    def close(self) -> None:
        """Wait for the thread; what it was building is dropped."""
        if self._pool is not None:
            with torch_threads():
                self._pool.shutdown(cancel_futures=True)


def looks_ahead(device: torch.device) -> bool:
    """Tell whether the detector leaves a core to whoever builds the next batch: on a GPU, and with fewer threads than
    cores.

    Otherwise a batch takes less time between two steps, from all threads together, than it takes away from the
    detector's threads, which wait for each other after every layer.
    """
    processes = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    return device.type != "cpu" or torch.get_num_threads() * processes < _cores()


def _cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class LogoChange:
    """Contrast, brightness and noise on the logo's colours: colours * factor + summand.

    The noise is drawn image by image from each image's own seed, so that it does not depend on who renders the image.
    """

    factor: Float[Tensor, "B 1 1"]
    summand: Float[Tensor, "B L 3"] | Float[Tensor, "B 1 1"]

    @staticmethod
    def draw(draws: Draws, settings: AugmentationSettings, faces: int, device: torch.device) -> "LogoChange | None":
        """Take the change of each image from its draws; None where the settings change nothing."""
        if not settings.noise and settings.contrast == Range(1.0, 1.0) and settings.brightness == Range(0.0, 0.0):
            return None
        factor, summand = (
            torch.from_numpy(values).float().to(device, non_blocking=True).view(-1, 1, 1)
            for values in (draws.contrast, draws.brightness)
        )
        if settings.noise:
            generator = torch.Generator(device=device)
            drawn = torch.empty(len(draws), faces, 3, device=device)
            for image, seed in zip(drawn, draws.seed.tolist(), strict=True):
                image.uniform_(-settings.noise, settings.noise, generator=generator.manual_seed(seed))
            summand = drawn.add_(summand)
        return LogoChange(factor, summand)

    def __call__(self, colors: Float[Tensor, "*B L 3"]) -> Float[Tensor, "B L 3"]:
        return torch.addcmul(self.summand, colors, self.factor)
