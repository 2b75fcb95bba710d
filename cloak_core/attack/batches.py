"""From draws to what compositing takes: views of dressed bodies, backgrounds, shifts, photometric changes."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from cloak_core.attack.sampling import Draws, Sampler, cameras
from cloak_core.attack.settings import TrainSettings, parse_angles
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
    photometric: Photometric | None

    def images(self, colors: Float[Tensor, "L 3"]) -> Float[Tensor, "B 3 H W"]:
        """The images, in [0, 1], differentiable in the colours."""
        return compose(self.views, colors, self.backgrounds, self.shifts, self.photometric)


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
        return Batch(
            views,
            self.backgrounds.batch(draws.background.tolist(), settings.size, settings.size).to(
                self.device, non_blocking=True
            ),
            torch.from_numpy(draws.shift).to(self.device, non_blocking=True),
            photometric(draws, settings, self.device),
        )


def photometric(draws: Draws, settings: TrainSettings, device: torch.device) -> Photometric | None:
    """Contrast, brightness and noise of some draws; None where all are off."""
    plain = (draws.contrast == 1).all() and (draws.brightness == 0).all() and not settings.noise
    if plain:
        return None
    as_tensor = lambda values: torch.from_numpy(values).float().to(device, non_blocking=True)
    return Photometric(
        contrast=as_tensor(draws.contrast),
        brightness=as_tensor(draws.brightness),
        noise=settings.noise,
        seed=int(draws.seed[0]),
        on=settings.photometric_on,
    )


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
