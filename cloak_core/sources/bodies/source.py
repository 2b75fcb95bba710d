"""Bodies as training sees them: a pose before a camera, rasterized, in what is worn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32

from cloak_core.core.cameras import Camera
from cloak_core.core.settings.components import ViewSettings
from cloak_core.core.settings.values import Range
from cloak_core.core.source import Dealt
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.core.worn import Worn
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.view_cache import ViewCache

FRESH_VIEWS_BYTES = 128 << 20
"""Memory for views that are used once."""
FRESH_SAMPLES = 4
"""Per pixel, in views that are used once, unless settings say otherwise: what sampling misses of a face in one view it
finds in the next, so that the error of single gradients averages out as the noise of small batches does."""


_CLOTH = 5
"""Stream of random numbers of an image, beside those drawn from its bare seed; techniques have others."""


@dataclass(frozen=True)
class BodyPlan:
    """Which pose, outfit and camera images get; it knows no vertices."""

    settings: ViewSettings
    members: int
    """Poses."""
    outfit_count: int

    @property
    def directions(self) -> int:
        """Training angles, or parts of a range of angles."""
        return len(self.settings.angles.starts)

    @property
    def is_fresh(self) -> bool:
        """Whether every image has a camera of its own, so that caching views gains nothing."""
        views = self.settings
        spread = views.angle_jitter, views.elevation_jitter, views.angles.width
        return any(spread) or views.distance.width > 0 or views.elevation.width > 0

    def draw(self, dealt: Dealt, random: np.random.Generator) -> dict[str, np.ndarray]:
        """See `Source`. Columns: pose and outfit, int64; azimuth and elevation, degrees; distance, metres."""
        views = self.settings
        count = len(dealt.images)

        def spread(values: Range) -> np.ndarray:
            return random.uniform(values.low, values.high, count)

        jitter = spread(Range(-views.angle_jitter, views.angle_jitter))
        outfits = self.outfit_count if views.outfits == "random" else 1
        outfit = random.integers(outfits, size=count)
        turn = random.uniform(0, views.angles.width, count)
        return {
            "pose": dealt.member,
            "outfit": outfit,
            "azimuth": np.array(views.angles.starts)[dealt.direction] + turn + jitter,
            "elevation": spread(views.elevation) + random.standard_normal(count) * views.elevation_jitter,
            "distance": spread(views.distance),
        }

    def camera(self, shown: Mapping[str, int | float]) -> Camera:
        """Make the camera of some columns. Equal columns give equal cameras, so that views are found again."""
        return self.settings.camera(shown["azimuth"], shown["elevation"], shown["distance"])


class BodySource:
    """A `Source` of bodies. `InputError`: see `ViewCache`."""

    def __init__(
        self,
        bodies: Bodies,
        worn: Worn,
        settings: ViewSettings,
        device: torch.device | str = "cpu",
        view_cache: ViewCache | None = None,
    ) -> None:
        """view_cache: of these bodies; one of its own where none is given."""
        self.bodies = bodies
        self.worn = worn
        self.plan = BodyPlan(settings, bodies.pose_count, bodies.outfit_count)
        self.directions = self.plan.directions
        self.members = self.plan.members
        self.is_fresh = self.plan.is_fresh
        self.draw = self.plan.draw
        if view_cache is None:
            fresh = {"samples": settings.samples or FRESH_SAMPLES, "memory_bytes": FRESH_VIEWS_BYTES}
            view_settings = RenderSettings.of(settings, device=device, **(fresh if self.is_fresh else {}))
            view_cache = ViewCache(bodies, view_settings, on_cloth=worn.cloth is not None)
        self.view_cache = view_cache
        self.works_on = view_cache.works_on

    def view(self, shown: Mapping[str, int | float], seed: int) -> BakedView:
        """See `Source`."""
        camera = self.plan.camera(shown)
        view = self.view_cache.bake(int(shown["pose"]), camera, self.worn.logo.face_ids, int(shown["outfit"]))
        return self.worn.on_body(view, np.random.default_rng([seed, _CLOTH]))

    def undressed(self, shown: Mapping[str, int | float], seed: int) -> None:
        """None: a body's clothing is painted."""

    def require_visible(self) -> None:
        """Require that some training view shows the logo. InputError: none does, of any pose at any training angle."""
        settings, faces = self.plan.settings, self.worn.logo.face_ids
        for azimuth in settings.angles.centers:
            camera = settings.camera(azimuth, settings.elevation.middle, settings.distance.low)
            for pose in range(self.members):
                if len(self.view_cache.bake(pose, camera, faces).map):
                    return
        raise InputError(
            f"the logo: none of its {len(faces)} faces is seen from the training angles {settings.angles}"
            + _unusual_size(self.bodies.vertices)
        )


def _unusual_size(vertices: Float32[np.ndarray, "P V 3"]) -> str:
    """Say how large the bodies are where no person is: a file in other units; "" where they are as large as people."""
    largest = float(np.ptp(vertices, axis=1).max())
    if 0.5 <= largest <= 3:
        return ""
    return f"; the body is {largest:.3g} m large, people are about 1.7 (in the scene's file, is a unit a metre?)"
