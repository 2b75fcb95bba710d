"""Rendered people for training: cropped views, sparse maps from face colours to pixels, dressed anew at every use."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.cameras import Camera
from cloak_core.core.view import View
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.view_cache import ViewCache

FRAME = 640
"""Views are rendered into a frame this wide, so that near people are whole; 416 of it is the field of view of 60."""
IMAGE = 416
FIELD_OF_VIEW = 2 * math.degrees(math.atan(math.tan(math.radians(30)) * FRAME / IMAGE))
Rng = np.random.Generator


@dataclass(frozen=True)
class CroppedView:
    """One person, cropped to its h x w box; `origin` (x, y) is that box's corner from the image's middle, in pixels of
    a 416-pixel image, and `distance` the camera's, in metres."""

    height: int
    width: int
    origin: tuple[int, int]
    distance: float
    cells: Tensor
    """[N] int64: covered pixels, flat in the crop."""
    alpha: Tensor
    """[N] float32 coverage."""
    specular: Tensor
    """[N] float32."""
    weights: Tensor
    """[N, F] sparse CSR: face colours to pixels."""

    def dress(self, colors: Float[Tensor, "F 3"]) -> Float[Tensor, "4 h w"]:
        """RGB, already multiplied with the coverage, and coverage."""
        patch = torch.zeros(self.height * self.width, 4)
        patch[self.cells, :3] = (self.weights @ colors + self.specular[:, None]).clamp(max=1)
        patch[self.cells, 3] = self.alpha
        return patch.reshape(self.height, self.width, 4).permute(2, 0, 1)


def random_camera(rng: Rng) -> Camera:
    """From all around, more often from the front; 1.4 to 5 metres; from a little below to well above."""
    azimuth = rng.uniform(-180, 180) if rng.random() < 0.55 else rng.normal(0, 20)
    distance = math.exp(rng.uniform(math.log(1.4), math.log(5))) if rng.random() < 0.75 else rng.uniform(2, 2.5)
    elevation = float(np.clip(rng.normal(6, 8), -10, 40))
    return Camera(distance, elevation, azimuth, FIELD_OF_VIEW, FRAME, FRAME)


def random_light(rng: Rng) -> Light:
    """A light from above, in front or to a side, of varying strength."""
    angle, ambient = rng.uniform(0, 2 * math.pi), rng.uniform(0.3, 0.65)
    position = (60 * math.cos(angle), rng.uniform(30, 90), 60 * math.sin(angle))
    return Light(ambient, 0.9 - ambient, rng.uniform(0, 0.3), rng.uniform(8, 64), position)


def render_people(
    bodies: Bodies, count: int, rng: Rng, on_view: Callable[[int], None] = lambda done: None
) -> list[CroppedView]:
    """`count` views of the poses in turn: two thirds under the default light, the rest under random ones."""
    lights = [Light()] * 8 + [random_light(rng) for _ in range(4)]
    view_cache = ViewCache(bodies, RenderSettings(samples=4))
    view_caches = [copy.copy(view_cache) for _ in lights]  # one geometry under many lights
    for lit, light in zip(view_caches, lights, strict=True):
        lit.settings = RenderSettings(samples=4, light=light)
    views = []
    for i in range(count):
        camera = random_camera(rng)
        (view,) = view_caches[rng.integers(len(view_caches))].build([(i % bodies.pose_count, camera)])
        views.append(_cropped(view, camera.distance, bodies.face_count))
        on_view(i + 1)
    return views


def _cropped(view: View, distance: float, face_count: int) -> CroppedView:
    rows, columns = view.pixels // view.width, view.pixels % view.width
    top, left = int(rows.min()), int(columns.min())
    height, width = int(rows.max()) - top + 1, int(columns.max()) - left + 1
    weights = torch.sparse_csr_tensor(
        view.crow.int(), view.face.int(), view.weight, (len(view.pixels), face_count), check_invariants=False
    )
    return CroppedView(
        height,
        width,
        (left - view.width // 2, top - view.height // 2),
        distance,
        (rows - top) * width + columns - left,
        view.coverage.float(),
        view.specular.float(),
        weights,
    )
