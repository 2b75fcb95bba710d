"""From draws to what compositing takes: views of dressed bodies, backgrounds, shifts, photometric changes."""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from cloak_core.core.cameras import Camera
from cloak_core.core.cloth_on_logo import ClothOnLogo
from cloak_core.core.distorting import Distortion, draw_occluders, draw_window, occluded
from cloak_core.core.geometry import face_centres
from cloak_core.core.paint import Canvas, blank, lay_backdrop, true_boxes
from cloak_core.core.people import PeopleViews
from cloak_core.core.sampling import Draws, Sampler, cameras, is_fresh
from cloak_core.core.settings import TrainSettings
from cloak_core.core.settings.components import AugmentationSettings, ViewSettings
from cloak_core.core.settings.values import Range
from cloak_core.core.view import BakedView, Photometric
from cloak_core.core.visibility.threads import spread, torch_threads, workers
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.view_cache import ViewCache

_MIX, _CUTOUT, _WINDOW, _TINT, _CLOTH = 1, 2, 3, 4, 5
"""Streams of random numbers of an image, beside those drawn from its bare seed."""


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

    def part(self, first: int, last: int) -> "Company":
        """Take the company of some of the images."""
        return Company(self.others[first:last], self.anywhere[first:last])


class Batcher:
    """Builds the batch of any step."""

    def __init__(
        self,
        settings: TrainSettings,
        sampler: Sampler,
        view_cache: ViewCache,
        logo_faces: np.ndarray,
        backgrounds: Backgrounds,
        device: torch.device,
        people: PeopleViews | None = None,
        cloth: ClothOnLogo | None = None,
    ) -> None:
        """cloth: what the colours are of, where they are not those of the logo's faces."""
        self.people, self.cloth = people, cloth
        self.color_count = len(logo_faces) if cloth is None else cloth.count
        self.views, self.augmentation, self.sampler, self.view_cache = (
            settings.views,
            settings.augmentation,
            sampler,
            view_cache,
        )
        self.logo_faces, self.backgrounds, self.device = logo_faces, backgrounds, device
        # Threads that only look views up would wait for each other.
        self._fresh = is_fresh(settings.views)
        self._centres = None
        if self.augmentation.cutout:
            self._centres = face_centres(view_cache.bodies)[logo_faces] if cloth is None else cloth.cloth.centres()

    def batch(self, step: int, rank: int = 0, ranks: int = 1) -> Batch:
        """Build the images of `step`, or one process's share of them."""
        draws = self.sampler.draw(step).share(rank, ranks)
        settings, size = self.augmentation, self.views.size
        empty = torch.empty(0, 3, size, size, device=self.device)
        if not len(draws):
            return Batch(empty, None, None, Distortion())
        places = draws.pose.tolist(), cameras(draws, self.views), draws.outfit.tolist()
        wanted = zip(*places, draws.person.tolist(), draws.seed.tolist(), strict=True)

        def bake(one: tuple[int, Camera, int, int, int]) -> BakedView:
            pose, camera, outfit, person, seed = one
            if person >= 0:
                return self.people.view(person, seed)
            view = self.view_cache.bake(pose, camera, self.logo_faces, outfit)
            return view if self.cloth is None else self.cloth.view(view, np.random.default_rng([seed, _CLOTH]))

        views = spread(bake, list(wanted), workers(self.device) if self._fresh else 1)
        changes = is_photometric(settings)
        on_logo = settings.photometric_on == "logo"
        rows = blank(len(views), size, size, self.device)
        lay_backdrop(
            rows, [self._backdrop(*one) for one in zip(draws.background.tolist(), draws.seed.tolist(), strict=True)]
        )
        # A photograph is moved by the part of it that is shown.
        shifts = torch.from_numpy(np.where(draws.person[:, None] >= 0, 0, draws.shift)).to(
            self.device, non_blocking=True
        )
        on_render = render_change(draws, settings, self.device) if changes and not on_logo else None
        distorted = distortion(draws, settings, self.device)
        return Batch(
            empty,
            self._occlude(Canvas.of(views, rows, shifts, on_render), views, draws),
            LogoChange.draw(draws, settings, self.color_count, self.device) if changes and on_logo else None,
            distorted,
            None if self._centres is None else self._cutout(draws),
            distorted.boxes(true_boxes(views, shifts), size, size),
            self._company(views, draws, distorted),
        )

    def _company(self, views: list[BakedView], draws: Draws, distorted: Distortion) -> Company | None:
        if self.people is None:
            return None
        boxes = [
            view.provenance.get("others", []) if p >= 0 else [] for view, p in zip(views, draws.person, strict=True)
        ]
        others = torch.zeros(len(views), max(map(len, boxes)), 4)
        size = self.views.size
        for k, of_image in enumerate(boxes):
            others[k, : len(of_image)] = torch.tensor(of_image, dtype=torch.float32).reshape(-1, 4)
        moved = [distorted.boxes(others[:, k], size, size) for k in range(others.shape[1])]
        others = torch.stack(moved, dim=1) if moved else others
        return Company(others.to(self.device), torch.from_numpy(draws.person < 0).to(self.device))

    def _backdrop(self, index: int, seed: int) -> UInt8[Tensor, "3 H W"]:
        """Take a background, mixed with a share of another one where the settings say so."""
        size, most = self.views.size, self.augmentation.background_mix
        image = self.backgrounds.image(index, (size, size))
        if not most:
            return image
        random = np.random.default_rng([seed, _MIX])
        other = self.backgrounds.image(int(random.integers(len(self.backgrounds))), (size, size))
        return torch.lerp(image.float(), other.float(), random.uniform(0, most)).round().to(torch.uint8)

    def _cutout(self, draws: Draws) -> Bool[Tensor, "B L"]:
        hidden = np.zeros((len(draws), len(self._centres)), bool)
        for row, seed in zip(hidden, draws.seed, strict=True):
            random = np.random.default_rng([seed, _CUTOUT])
            about = self._centres[random.integers(len(row))]
            count = round(random.uniform(0, self.augmentation.cutout) * len(row))
            apart = ((self._centres - about) ** 2).sum(1)
            row[np.argsort(apart, kind="stable")[:count]] = True
        return torch.from_numpy(hidden).to(self.device)

    def _occlude(self, canvas: Canvas, views: list[BakedView], draws: Draws) -> Canvas:
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
    def draw(draws: Draws, settings: AugmentationSettings, faces: int, device: torch.device) -> "LogoChange":
        factor, summand = (_on(device, values).view(-1, 1, 1) for values in (draws.contrast, draws.brightness))
        if settings.noise:
            generator = torch.Generator(device=device)
            drawn = torch.empty(len(draws), faces, 3, device=device)
            for image, seed in zip(drawn, draws.seed.tolist(), strict=True):
                image.uniform_(-settings.noise, settings.noise, generator=generator.manual_seed(seed))
            summand = drawn.add_(summand)
        return LogoChange(factor, summand)

    def __call__(self, colors: Float[Tensor, "*B L 3"]) -> Float[Tensor, "B L 3"]:
        return torch.addcmul(self.summand, colors, self.factor)


def is_photometric(settings: AugmentationSettings) -> bool:
    """Tell whether contrast, brightness or noise change anything."""
    return bool(settings.noise) or settings.contrast != Range(1.0, 1.0) or settings.brightness != Range(0.0, 0.0)


def distortion(draws: Draws, settings: AugmentationSettings, device: torch.device) -> Distortion:
    """Gather what happens to the finished images."""
    return Distortion(
        _on(device, draws.zoom) if settings.zoom != Range(1.0, 1.0) else None,
        _on(device, _windows(draws, settings)) if settings.crop or settings.pad else None,
        _on(device, _tints(draws, settings)) if settings.tint else None,
        _on(device, draws.blur) if settings.blur else None,
        _on(device, draws.quality) if settings.jpeg is not None else None,
    )


def _windows(draws: Draws, settings: AugmentationSettings) -> Float[np.ndarray, "B 3"]:
    drawn = [draw_window(np.random.default_rng([seed, _WINDOW]), settings.crop, settings.pad) for seed in draws.seed]
    return np.array(drawn).reshape(-1, 3)


def _tints(draws: Draws, settings: AugmentationSettings) -> Float[np.ndarray, "B 4"]:
    drawn = [np.random.default_rng([seed, _TINT]).uniform(-settings.tint, settings.tint, 4) for seed in draws.seed]
    return 1 + np.array(drawn).reshape(-1, 4)


def render_change(draws: Draws, settings: AugmentationSettings, device: torch.device) -> Photometric:
    """Draw contrast, brightness and noise on the body's pixels.

    The noise has one seed for all images that a process composes together.
    """
    seed = int(draws.seed[0]) if len(draws) else 0
    contrast, brightness = _on(device, draws.contrast), _on(device, draws.brightness)
    return Photometric(contrast, brightness, settings.noise, seed)


def _on(device: torch.device, values: np.ndarray) -> Tensor:
    return torch.from_numpy(values).float().to(device, non_blocking=True)


def require_visible_logo(
    view_cache: ViewCache, logo_faces: np.ndarray, pose_count: int, settings: ViewSettings
) -> None:
    """Require that some training view shows the logo. InputError: none does, of any pose at any training angle."""
    for azimuth in settings.angles.centers:
        camera = settings.camera(azimuth, settings.elevation.middle, settings.distance.low)
        for pose in range(pose_count):
            if len(view_cache.bake(pose, camera, logo_faces).logo_rows):
                return
    raise InputError(
        f"the logo: none of its {len(logo_faces)} faces is seen from the training angles {settings.angles}"
    )
