"""From draws to what compositing takes: views of dressed bodies, backgrounds, shifts, photometric changes."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from cloak_core.attack.parsing import parse_angles, parse_range
from cloak_core.attack.sampling import Draws, Sampler, cameras
from cloak_core.attack.settings import TrainSettings
from cloak_core.errors import InputError
from cloak_core.render.compositing import Photometric, compose
from cloak_core.render.views import DressedView, ViewBank
from cloak_core.scene.backgrounds import Backgrounds
from cloak_core.scene.cameras import Camera


@dataclass(frozen=True)
class Batch:
    """Everything of B images but the logo's colours."""

    views: list[DressedView]
    backgrounds: Float[Tensor, "B 3 H W"]
    shifts: Int[Tensor, "B 2"]
    on_logo: "LogoChange | None"
    on_render: Photometric | None

    def images(self, colors: Float[Tensor, "L 3"]) -> Float[Tensor, "B 3 H W"]:
        """The images, in [0, 1], differentiable in the colours; none where a short batch left this process none."""
        if not self.views:
            return self.backgrounds + 0 * colors.sum()
        if self.on_logo is not None:
            colors = self.on_logo(colors)
        return compose(self.views, colors, self.backgrounds, self.shifts, self.on_render)


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
        self.settings, self.sampler, self.bank = settings, sampler, bank
        self.logo_faces, self.backgrounds, self.device = logo_faces, backgrounds, device

    def batch(self, step: int, rank: int = 0, ranks: int = 1) -> Batch:
        """The images of `step`, or one process's share of them."""
        draws = self.sampler.draw(step).share(rank, ranks)
        settings = self.settings
        views = [
            self.bank.dress(int(pose), camera, self.logo_faces, int(outfit))
            for pose, outfit, camera in zip(draws.pose, draws.outfit, cameras(draws, settings), strict=True)
        ]
        changes = is_photometric(settings)
        on_logo = settings.photometric_on == "logo"
        return Batch(
            views,
            self.backgrounds.batch(draws.background.tolist(), settings.size, settings.size).to(
                self.device, non_blocking=True
            ),
            torch.from_numpy(draws.shift).to(self.device, non_blocking=True),
            LogoChange.draw(draws, settings, self.device) if changes and on_logo else None,
            render_change(draws, settings, self.device) if changes and not on_logo else None,
        )


class Prefetcher:
    """A batcher that builds the next batch in a thread while the detector is busy with this one.

    What a batch holds depends on its step alone, so that looking ahead changes nothing but time.
    """

    def __init__(self, batcher: Batcher, rank: int = 0, ranks: int = 1) -> None:
        self._batcher, self._rank, self._ranks = batcher, rank, ranks
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="batches")
        self._next: tuple[int, Future] | None = None

    def batch(self, step: int) -> Batch:
        """The batch of `step`; that of `step + 1` is begun."""
        expected = self._next is not None and self._next[0] == step
        ready = self._next[1].result() if expected else self._batcher.batch(step, self._rank, self._ranks)
        if step + 1 < self._batcher.sampler.steps:
            self._next = (step + 1, self._pool.submit(self._batcher.batch, step + 1, self._rank, self._ranks))
        return ready

    def close(self) -> None:
        """Wait for the thread; what it was building is dropped."""
        self._pool.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class LogoChange:
    """Contrast, brightness and noise on the logo's colours: colours * factor + summand.

    The noise is drawn image by image from each image's own seed, so that it does not depend on who renders the image.
    """

    factor: Float[Tensor, "B 1 1"]
    summand: Float[Tensor, "B 1 1"]
    noise: float
    seeds: tuple[int, ...]

    @staticmethod
    def draw(draws: Draws, settings: TrainSettings, device: torch.device) -> "LogoChange":
        put = lambda values: torch.from_numpy(values).float().to(device, non_blocking=True).view(-1, 1, 1)
        return LogoChange(put(draws.contrast), put(draws.brightness), settings.noise, tuple(draws.seed.tolist()))

    def __call__(self, colors: Float[Tensor, "L 3"]) -> Float[Tensor, "B L 3"]:
        summand = self.summand
        if self.noise:
            generator = torch.Generator(device=colors.device)
            drawn = colors.new_empty(len(self.seeds), *colors.shape)
            for image, seed in zip(drawn, self.seeds, strict=True):
                image.uniform_(-self.noise, self.noise, generator=generator.manual_seed(seed))
            summand = drawn.add_(summand)
        return torch.addcmul(summand, colors, self.factor)


def is_photometric(settings: TrainSettings) -> bool:
    """Whether contrast, brightness or noise change anything."""
    off = parse_range(settings.contrast, "--contrast") == (1, 1) and parse_range(
        settings.brightness, "--brightness"
    ) == (0, 0)
    return bool(settings.noise) or not off


def render_change(draws: Draws, settings: TrainSettings, device: torch.device) -> Photometric:
    """The same on the body's pixels. Its noise has one seed for all images that a process composes together."""
    put = lambda values: torch.from_numpy(values).float().to(device, non_blocking=True)
    seed = int(draws.seed[0]) if len(draws) else 0
    return Photometric(put(draws.contrast), put(draws.brightness), settings.noise, seed, "render")


def require_visible_logo(bank: ViewBank, logo_faces: np.ndarray, pose_count: int, settings: TrainSettings) -> None:
    """InputError when no training view (any pose at any training angle) shows any part of the logo."""
    low = float(settings.distance.split(":")[0])
    for azimuth in parse_angles(settings.angles):
        camera = Camera(
            distance=low,
            elevation=settings.elevation,
            azimuth=azimuth,
            field_of_view=settings.field_of_view,
            width=settings.size,
            height=settings.size,
        )
        for pose in range(pose_count):
            if len(bank.dress(pose, camera, logo_faces).logo_rows):
                return
    raise InputError(
        f"the logo: none of its {len(logo_faces)} faces is seen from the training angles {settings.angles}"
    )
