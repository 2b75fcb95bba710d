"""Bodies before a camera, rasterized: a source of views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
import torch

from cloak_core.core.cameras import Camera
from cloak_core.core.logo import Cover
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings.components import ViewSettings
from cloak_core.core.settings.values import Range
from cloak_core.core.source import Dealt
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
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
        return (
            views.elevation_jitter > 0
            or views.angles.width > 0
            or views.distance.width > 0
            or views.elevation.width > 0
        )

    def draw(self, dealt: Dealt, random: np.random.Generator) -> dict[str, np.ndarray]:
        """See `Source`. Columns: pose and outfit, int64; azimuth and elevation, degrees; distance, metres."""
        views = self.settings
        count = len(dealt.images)

        def spread(values: Range) -> np.ndarray:
            return random.uniform(values.low, values.high, count)

        random.random(count)  # an option of earlier versions drew these: what follows keeps its bits
        outfit = random.integers(self.outfit_count, size=count)
        turn = random.uniform(0, views.angles.width, count)
        return {
            "pose": dealt.member,
            "outfit": outfit,
            "azimuth": np.array(views.angles.starts)[dealt.direction] + turn,
            "elevation": spread(views.elevation) + random.standard_normal(count) * views.elevation_jitter,
            "distance": spread(views.distance),
        }


class BodySource:
    """A `Source` of bodies before a camera. `InputError`: see `ViewCache`."""

    directions, members, is_fresh = 1, 0, False

    def __init__(
        self,
        bodies: Bodies,
        settings: RenderSettings,
        viewpoint: Camera,
        plan: BodyPlan | None = None,
        on_cloth: bool = False,
    ) -> None:
        """viewpoint: the camera, but for azimuth, elevation and distance; plan: of a training, which draws those.

        on_cloth: whether some pattern needs views that tell where on a cloth places lie; others then share them.
        """
        self.bodies, self.settings, self.viewpoint = bodies, settings, viewpoint
        self.plan, self.on_cloth = plan, on_cloth
        self._caches: dict[bool, ViewCache] = {}
        if plan is not None:
            self.directions, self.members, self.is_fresh = plan.directions, plan.members, plan.is_fresh

    @classmethod
    def trained(cls, bodies: Bodies, settings: ViewSettings, device: torch.device | str = "cpu") -> BodySource:
        """Show bodies as the settings of a training say."""
        plan = BodyPlan(settings, bodies.pose_count, bodies.outfit_count)
        fresh = {"samples": settings.samples or FRESH_SAMPLES, "memory_bytes": FRESH_VIEWS_BYTES}
        render = RenderSettings.of(settings, device=device, **(fresh if plan.is_fresh else {}))
        return cls(bodies, render, settings.camera(0.0, 0.0, 1.0), plan)

    def draw(self, dealt: Dealt, random: np.random.Generator) -> dict[str, np.ndarray]:
        """See `Source`."""
        return self.plan.draw(dealt, random)

    def planned(self, plan: BodyPlan | None, viewpoint: Camera) -> BodySource:
        """Show the same bodies as another plan says, from views that are kept together."""
        source = BodySource(self.bodies, self.settings, viewpoint, plan)
        source._caches = self._caches
        return source

    @property
    def works_on(self) -> torch.device:
        """See `Source`; see `ViewCache`."""
        return torch.device("cpu" if self.settings.by_area else self.settings.device)

    @cached_property
    def identity(self) -> str:
        """See `Source`."""
        render = [self.settings.samples, asdict(self.settings.light), str(self.settings.device), self.on_cloth]
        return sha256_record([self.bodies.identity, render, asdict(self.viewpoint)])

    def views_for(self, needs_cloth: bool) -> ViewCache:
        """Give the cache of views that tell where on a cloth places lie, or of those that do not."""
        if needs_cloth not in self._caches:
            # Threads that make views may ask at once; all of them get the same.
            self._caches.setdefault(needs_cloth, ViewCache(self.bodies, self.settings, on_cloth=needs_cloth))
        return self._caches[needs_cloth]

    def camera(self, shown: Mapping[str, int | float]) -> Camera:
        """Make the camera of some columns. Equal columns give equal cameras, so that views are found again."""
        place = {name: float(shown[name]) for name in ("azimuth", "elevation", "distance")}
        return replace(self.viewpoint, **place)

    def view(self, shown: Mapping[str, int | float], seed: int | None, pattern: Pattern) -> BakedView:
        """See `Source`."""
        faces = check_topology(pattern.cover, self.bodies).face_ids
        cache = self.views_for(pattern.needs_cloth or self.on_cloth)
        view = cache.bake(int(shown["pose"]), self.camera(shown), faces, int(shown["outfit"]))
        return view if seed is None else replace(view, stream=(seed, _CLOTH))

    def require_visible(self, pattern: Pattern) -> None:
        """Require that some training view shows what is worn. InputError: none does, at any training angle."""
        settings, faces = self.plan.settings, pattern.cover.face_ids
        for azimuth in settings.angles.centers:
            camera = settings.camera(azimuth, settings.elevation.middle, settings.distance.low)
            for pose in range(self.members):
                if self.views_for(pattern.needs_cloth).bake(pose, camera, faces).map.height:
                    return
        largest = float(np.ptp(self.bodies.vertices, axis=1).max())
        size = f"the body is {largest:.3g} m large, people are about 1.7 (in the scene's file, is a unit a metre?)"
        raise InputError(
            f"the logo: none of its {len(faces)} faces is seen from the training angles {settings.angles}"
            + ("" if 0.5 <= largest <= 3 else f"; {size}")
        )


def check_topology(cover: Cover, bodies: Bodies) -> Cover:
    """Return faces that are those of these bodies. InputError: they are another mesh's, with both topologies."""
    if cover.topology != bodies.topology:
        made = f"the logo was made for topology {cover.topology}, this scene has {bodies.topology}"
        raise InputError(f"scene '{bodies.name}': {made}")
    return cover
