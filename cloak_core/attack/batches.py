"""From draws to what compositing takes: views of dressed bodies, backgrounds, shifts, photometric changes."""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.attack.distorting import Distortion, draw_occluders, occluded
from cloak_core.attack.sampling import Draws, Sampler, cameras, is_fresh
from cloak_core.attack.settings import TrainSettings
from cloak_core.attack.settings.augmentation import AugmentationSettings
from cloak_core.attack.settings.values import Range
from cloak_core.attack.settings.views import ViewSettings
from cloak_core.files.errors import InputError
from cloak_core.render.backdrop import lay_backdrop
from cloak_core.render.compositing import Canvas, Photometric, blank, true_boxes
from cloak_core.render.dressing import DressedView
from cloak_core.render.threads import own_threads_kept, spread, workers
from cloak_core.render.views import ViewBank
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.cameras import Camera


@dataclass(frozen=True)
class Batch:
    """B images that lack nothing but the logo's colours."""

    empty: Float[Tensor, "0 3 H W"]
    """What there is to see where a short batch left this process no image."""
    canvas: Canvas | None
    """None there."""
    on_logo: "LogoChange | None"
    distortion: Distortion

    def __len__(self) -> int:
        return self.canvas.shape[0] if self.canvas else 0

    def images(self, colors: Float[Tensor, "L 3"]) -> Float[Tensor, "B 3 H W"]:
        """The images, in [0, 1], differentiable in the colours. The next call draws into the same memory."""
        if self.canvas is None:
            return self.empty + 0 * colors.sum()
        return self.distortion(self.canvas.paint(colors if self.on_logo is None else self.on_logo(colors)))


class Batcher:
    """Builds the batch of any step."""

    def __init__(
        self,
        settings: TrainSettings,
        sampler: Sampler,
        bank: ViewBank,
        logo_faces: np.ndarray,
        backgrounds: Backgrounds,
        device: torch.device,
    ) -> None:
        self.views, self.augmentation, self.sampler, self.bank = settings.views, settings.augmentation, sampler, bank
        self.logo_faces, self.backgrounds, self.device = logo_faces, backgrounds, device
        # Threads that only look views up would wait for each other.
        self._fresh = is_fresh(settings.views)

    def batch(self, step: int, rank: int = 0, ranks: int = 1) -> Batch:
        """The images of `step`, or one process's share of them."""
        draws = self.sampler.draw(step).share(rank, ranks)
        settings, size = self.augmentation, self.views.size
        empty = torch.empty(0, 3, size, size, device=self.device)
        if not len(draws):
            return Batch(empty, None, None, Distortion())
        wanted = zip(draws.pose.tolist(), cameras(draws, self.views), draws.outfit.tolist(), strict=True)

        def dress(one: tuple[int, Camera, int]) -> DressedView:
            pose, camera, outfit = one
            return self.bank.dress(pose, camera, self.logo_faces, outfit)

        views = spread(dress, list(wanted), workers(self.device) if self._fresh else 1)
        changes = is_photometric(settings)
        on_logo = settings.photometric_on == "logo"
        rows = blank(len(views), size, size, self.device)
        lay_backdrop(rows, [self.backgrounds.image(index, (size, size)) for index in draws.background.tolist()])
        shifts = torch.from_numpy(draws.shift).to(self.device, non_blocking=True)
        on_render = render_change(draws, settings, self.device) if changes and not on_logo else None
        return Batch(
            empty,
            self._occlude(Canvas.of(views, rows, shifts, on_render), views, draws),
            LogoChange.draw(draws, settings, len(self.logo_faces), self.device) if changes and on_logo else None,
            distortion(draws, settings, self.device),
        )

    def _occlude(self, canvas: Canvas, views: list[DressedView], draws: Draws) -> Canvas:
        if not self.augmentation.occluders:
            return canvas
        size, boxes, pictures = self.views.size, [], []
        bodies = true_boxes(views, torch.from_numpy(draws.shift)).cpu().tolist()
        for image, seed in enumerate(draws.seed.tolist()):
            random = np.random.default_rng(seed)
            own = draw_occluders(random, bodies[image], self.augmentation.occluders, size)
            boxes += [(image, *box) for box in own]
            chosen = random.integers(len(self.backgrounds), size=len(own)).tolist()
            pictures += [self.backgrounds.image(index, (size, size)) for index in chosen]
        return occluded(canvas, boxes, pictures)


class Prefetcher:
    """A batcher that, where it gains time, builds the next batch in a thread while the detector is busy with this one.

    What a batch holds depends on its step alone, so that looking ahead changes nothing but time.
    """

    def __init__(self, batcher: Batcher, rank: int = 0, ranks: int = 1) -> None:
        self._batcher, self._rank, self._ranks = batcher, rank, ranks
        self._pool: ThreadPoolExecutor | None = None
        if looks_ahead(batcher.device):
            # On one CPU thread: a second team of threads would fight the detector's for the cores.
            self._pool = ThreadPoolExecutor(1, "batches", torch.set_num_threads, (1,))
        self._next: tuple[int, Future] | None = None

    def batch(self, step: int) -> Batch:
        """The batch of `step`; that of `step + 1` is begun."""
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
            with own_threads_kept():
                self._pool.shutdown(cancel_futures=True)


def looks_ahead(device: torch.device) -> bool:
    """Whether the detector leaves a core to whoever builds the next batch: on a GPU, and with fewer threads than cores.

    Otherwise a batch takes less time between two steps, from all threads together, than it takes away from the
    detector's threads, which wait for each other after every layer.
    """
    processes = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    return device.type != "cpu" or torch.get_num_threads() * processes < _cores()


def _cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class LogoChange:
    """Contrast, brightness and noise on the logo's colours: colours * factor + summand.

    The noise is drawn image by image from each image's own seed, so that it does not depend on who renders the image.
    """

    factor: Float[Tensor, "B 1 1"]
    summand: Float[Tensor, "B L 3"] | Float[Tensor, "B 1 1"]

    @staticmethod
    def draw(draws: Draws, settings: AugmentationSettings, faces: int, device: torch.device) -> "LogoChange":
        factor, summand = (_on(device, values).view(-1, 1, 1) for values in (draws.contrast, draws.brightness))
        if settings.noise:
            generator = torch.Generator(device=device)
            drawn = torch.empty(len(draws), faces, 3, device=device)
            for image, seed in zip(drawn, draws.seed.tolist(), strict=True):
                image.uniform_(-settings.noise, settings.noise, generator=generator.manual_seed(seed))
            summand = drawn.add_(summand)
        return LogoChange(factor, summand)

    def __call__(self, colors: Float[Tensor, "L 3"]) -> Float[Tensor, "B L 3"]:
        return torch.addcmul(self.summand, colors, self.factor)


def is_photometric(settings: AugmentationSettings) -> bool:
    """Whether contrast, brightness or noise change anything."""
    return bool(settings.noise) or settings.contrast != Range(1.0, 1.0) or settings.brightness != Range(0.0, 0.0)


def distortion(draws: Draws, settings: AugmentationSettings, device: torch.device) -> Distortion:
    """What happens to the finished images."""
    return Distortion(
        _on(device, draws.zoom) if settings.zoom != Range(1.0, 1.0) else None,
        _on(device, draws.blur) if settings.blur else None,
        _on(device, draws.quality) if settings.jpeg is not None else None,
    )


def render_change(draws: Draws, settings: AugmentationSettings, device: torch.device) -> Photometric:
    """The same on the body's pixels. Its noise has one seed for all images that a process composes together."""
    seed = int(draws.seed[0]) if len(draws) else 0
    contrast, brightness = _on(device, draws.contrast), _on(device, draws.brightness)
    return Photometric(contrast, brightness, settings.noise, seed)


def _on(device: torch.device, values: np.ndarray) -> Tensor:
    return torch.from_numpy(values).float().to(device, non_blocking=True)


def require_visible_logo(bank: ViewBank, logo_faces: np.ndarray, pose_count: int, settings: ViewSettings) -> None:
    """InputError when no training view (any pose at any training angle) shows any part of the logo."""
    for azimuth in settings.angles.centers:
        camera = settings.camera(azimuth, settings.elevation.middle, settings.distance.low)
        for pose in range(pose_count):
            if len(bank.dress(pose, camera, logo_faces).logo_rows):
                return
    raise InputError(
        f"the logo: none of its {len(logo_faces)} faces is seen from the training angles {settings.angles}"
    )
