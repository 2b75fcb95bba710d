"""Views of a scene, built once and kept.

A view is one pose seen by one camera: for each covered pixel, the weights of the faces' colours. Baking a view
for a logo folds all else into a constant base image; rendering a baked view is a sparse product (`core/paint.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64
from torch import Tensor

from cloak_core.core.cameras import Camera, Vector
from cloak_core.core.geometry import outward_parts
from cloak_core.core.paint import bake
from cloak_core.core.places import corner_places
from cloak_core.core.view import BakedView, Fragments, Screen, Surface, View, Visibility, Window
from cloak_core.core.visibility.compiled import backend
from cloak_core.core.visibility.normals import NormalOperator
from cloak_core.core.visibility.projection import project
from cloak_core.core.visibility.rasterizer import area_fragments, bounding_window, merge_samples, rasterize, row_bands
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.core.visibility.threads import spread, torch_threads, workers
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.caching import MemoryCache
from cloak_core.files.errors import InputError

BAND_SAMPLES = {"cpu": 1 << 21, "cuda": 1 << 25}
"""Samples of a view held at once; more on the CPU leave its caches and take longer."""

Key = tuple[int, Camera]
"""A pose and a camera."""


class ViewCache:
    """Builds views of bodies and keeps the latest ones, up to a budget of memory.

    Raises `InputError` for a pose or an outfit that the scene does not have.
    """

    def __init__(self, bodies: Bodies, settings: RenderSettings | None = None, *, on_cloth: bool = False) -> None:
        """on_cloth: views tell where on a cloth (exchange/cloth.py) each entry lies."""
        self.bodies = bodies
        self.settings = settings or RenderSettings()
        self.device = torch.device(self.settings.device)
        # Exact areas take a GPU thousands of small operations, minutes a view on an H100; the CPU some hundredths of a
        # second.
        self.works_on = torch.device("cpu") if self.settings.by_area else self.device

        def put(array: np.ndarray, dtype: torch.dtype, device: torch.device = self.works_on) -> Tensor:
            # A copy, always: torch takes no read-only arrays.
            return torch.tensor(np.ascontiguousarray(array), dtype=dtype, device=device)

        self._colors = put(bodies.face_colors, torch.float32, self.device)
        images = [bodies.texture_of(outfit) for outfit in range(bodies.outfit_count)]
        self._textures = [None if image is None else put(image, torch.uint8, self.device) for image in images]
        textured = any(image is not None for image in images)
        split = not np.array_equal(bodies.triangle_face, np.arange(bodies.triangle_count))
        self._surface = Surface(
            put(bodies.triangles.T, torch.int64),
            put(bodies.triangle_face, torch.int64),
            put(bodies.uv[bodies.triangle_uv].T, torch.float32) if textured else None,
            put(corner_places(bodies), torch.float32) if on_cloth else None,
            self.settings.light,
            bodies.face_count,
            by_face=split and not textured and not on_cloth,
        )
        self._normals = NormalOperator(self._surface.triangles, bodies.vertex_count)
        self._outward = outward_parts(bodies)
        self._kept = MemoryCache(self.settings.memory_bytes)

    def view(self, pose: int, camera: Camera) -> View:
        """Return one view, see `views`."""
        return self.views([(pose, camera)])[0]

    def views(self, keys: Sequence[Key]) -> list[View]:
        """Give views, from memory where they were built before; the others are built together."""
        by_key = {key: self._kept.get(("view", *key)) for key in keys}
        new = [key for key, view in by_key.items() if view is None]
        for key, view in zip(new, self.build(new) if new else [], strict=True):
            by_key[key] = self._kept.put(("view", *key), view)
        return [by_key[key] for key in keys]

    def bake(self, pose: int, camera: Camera, logo_faces: object, outfit: int = 0) -> BakedView:
        """Bake everything but the logo's colours (faces [L], int64) into the view, in one of the outfits."""
        faces = np.ascontiguousarray(logo_faces, np.int64)
        key = ("baked", pose, camera, outfit, faces.tobytes())
        baked = self._kept.get(key)
        if baked is None:
            if not 0 <= outfit < self.bodies.outfit_count:
                raise InputError(f"outfit {outfit}: the scene has {self.bodies.outfit_count}")
            view, logo = self.view(pose, camera), torch.from_numpy(faces).to(self.device)
            worn = self._colors[outfit], self.settings.light.color, self._textures[outfit]
            baked = self._kept.put(key, bake(view, logo, *worn))
        return baked

    def build(self, keys: Sequence[Key]) -> list[View]:
        """Rasterize and light views, without keeping them: one by one, so that memory is that of one.

        On the CPU, torch's threads share the views, or the one view's rows.
        """
        count = self._workers(len(keys))
        if len(keys) == 1:
            with torch_threads(1):
                return [self._build(keys[0], count)]
        self._load_poses(keys)
        return spread(self._build, keys, count)

    def _build(self, key: Key, count: int = 1) -> View:
        screen, stage = self.screen([key]), backend(self.works_on)
        pose, camera = self._pose(key[0]), key[1]
        # Vertex normals and the light's position, in the view's space.
        right, up, back = camera.axes
        axes = (right, up, tuple(-b for b in back))
        position = camera.position(camera.pivot or pose.center)
        offset = [a - b for a, b in zip(self.settings.light.position, position, strict=True)]
        light = [sum(a * o for a, o in zip(axis, offset, strict=True)) for axis in axes]
        rotation, light = (torch.tensor(t, dtype=torch.float32).to(self.works_on) for t in (axes, light))
        normals = rotation @ pose.normals
        lit = lambda band: stage.build_view(self._band(key, screen, band), screen, self._surface, normals, light)
        return View.join(spread(lit, self._bands(screen, count), count)).to(self.device)

    def screen(self, keys: Sequence[Key]) -> Screen:
        """Project the views' vertices to the screen."""
        with torch_threads(1):
            poses = [self._pose(pose) for pose, _ in keys]
            only = len(poses) == 1
            vertices = poses[0].vertices.unsqueeze(0) if only else torch.stack([pose.vertices for pose in poses])
            pivots = [camera.pivot or pose.center for pose, (_, camera) in zip(poses, keys, strict=True)]
            return project(vertices, [camera for _, camera in keys], pivots)

    def visibility(self, keys: Sequence[Key], screen: Screen, window: Window | None = None) -> Visibility:
        """Find the nearest triangle at every sample."""
        with torch_threads(1):
            return rasterize(screen, self._surface.triangles, self.settings.grid, self.cull(keys, screen), window)

    def visible(self, keys: Sequence[Key]) -> list[Visibility] | list[Fragments]:
        """Find what is visible, unlit, in parts: samples, or where coverage is measured by area, fragments."""
        self._load_poses(keys)
        count = self._workers(len(keys))
        bands_of_view = count if len(keys) == 1 else 1
        screens = [(key, self.screen([key])) for key in keys]
        bands = [(key, screen, band) for key, screen in screens for band in self._bands(screen, bands_of_view)]
        find = self._band if self.settings.by_area else lambda key, *where: self.visibility([key], *where)
        return spread(lambda part: find(*part), bands, count)

    def _workers(self, views: int) -> int:
        """Choose how many CPU threads share the work.

        A view of few samples is quicker on one thread than on two that wait for each other's Python.
        """
        return 1 if views == 1 and self.settings.samples in (1, 4) else workers(self.works_on)

    def cull(self, keys: Sequence[Key], screen: Screen) -> Bool[Tensor, "B T"]:
        """Mark triangles whose back faces are dropped: those of closed surfaces that face outwards.

        Not in views where the near plane cuts bodies open.
        """
        cull = torch.from_numpy(self._outward[[pose for pose, _ in keys]])
        if screen.in_guard_band is not None:
            cull &= (screen.view[:, 2] >= screen.near).all(1, keepdim=True).cpu()
        return cull

    def _load_poses(self, keys: Sequence[Key]) -> None:
        """Prepare the poses, before several threads ask for them at once."""
        for pose, _ in keys:
            self._pose(pose)

    def _bands(self, screen: Screen, count: int) -> list[Window]:
        """Cut one view's window into bands for `count` threads, each of no more samples than are held at once."""
        window = bounding_window(screen)
        rows = max(1, window.y1 - window.y0)
        if not self.settings.by_area:  # areas are cut further by the pixels that triangles touch
            most = BAND_SAMPLES.get(self.works_on.type, BAND_SAMPLES["cpu"])
            rows = max(1, most // max(1, (window.x1 - window.x0) * self.settings.grid**2))
        bands = [
            replace(band, y0=y, y1=min(y + rows, band.y1))
            for band in row_bands(screen, window, count)
            for y in range(band.y0, band.y1, rows)
        ]
        return bands or [window]

    def _band(self, key: Key, screen: Screen, window: Window) -> Fragments:
        if self.settings.by_area:
            return area_fragments(screen, self._surface.triangles, self.cull([key], screen), window)
        return merge_samples(self.visibility([key], screen, window))

    def _pose(self, index: int) -> _Pose:
        pose = self._kept.get(("pose", index))
        if pose is None:
            if not 0 <= index < self.bodies.pose_count:
                raise InputError(f"pose {index}: the scene has {self.bodies.pose_count}")
            own = self.bodies.vertices[index]
            vertices = torch.from_numpy(own.T.astype(np.float64)).to(self.works_on).contiguous()
            low, high = own.min(0, initial=np.inf), own.max(0, initial=-np.inf)
            center = tuple(((low.astype(np.float64) + high) / 2).tolist()) if vertices.shape[1] else (0.0, 0.0, 0.0)
            pose = self._kept.put(("pose", index), _Pose(vertices, self._normals(vertices), center))
        return pose


@dataclass(frozen=True, eq=False)
class _Pose:
    vertices: Float64[Tensor, "3 V"]
    normals: Float32[Tensor, "3 V"]
    center: Vector
    """Of the bounding box."""
