"""Views as sparse matrices, built once and kept.

A view is one pose seen by one camera: for each covered pixel, how much of which face's colour it shows. Dressing a
view for a logo folds everything that is not the logo into a constant base image; rendering a dressed view is a sparse
product (see compositing.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64
from torch import Tensor

from cloak_core.exchange.bodies import Bodies
from cloak_core.files.caching import DiskCache, MemoryCache
from cloak_core.files.errors import InputError
from cloak_core.render.compiled import use_loops
from cloak_core.render.images.dressing import DressedView, dress
from cloak_core.render.threads import even, one_thread, spread, workers
from cloak_core.render.view_files import StoredViews
from cloak_core.render.visibility.area import area_fragments
from cloak_core.render.visibility.projection import Screen, Window, project
from cloak_core.render.visibility.rasterizer import Visibility, bounding_window, rasterize, row_bands
from cloak_core.render.weights.assembly import Lit, assemble, view_by_loops
from cloak_core.render.weights.fragments import Fragments, light_fragments, merge_samples
from cloak_core.render.weights.shading import Light, NormalOperator
from cloak_core.render.weights.view import View
from cloak_core.scene.cameras import Camera, Vector
from cloak_core.scene.geometry import is_closed, is_outward

GRIDS = {1: 1, 4: 2, 16: 4, 64: 8}
"""Samples per pixel, and how many of them stand along a pixel's side."""
AREA_SAMPLES = 64
"""Samples per pixel of `ViewBank.visibility` where coverage is measured by area."""
BATCH_NUMBERS = {"cpu": 1 << 21, "cuda": 1 << 25}
"""Numbers of 8 bytes held at once while views are built; more on the CPU leave its caches and take longer."""
PIECE_COST = 16
"""Numbers held for each triangle where coverage is measured by area (areas keep to bands of their own)."""


class ViewBank:
    """Builds views of bodies and keeps the latest ones, up to a budget of memory.

    bodies: the scene; light: see `Light`; memory_bytes: for kept views. samples: where absent, coverage is measured by
    exact area (see area.py), the best there is for its time (docs/accuracy.md); 1, 4, 16 or 64 count samples instead.
    files: where views are kept between runs (see view_files.py), None: nowhere.
    Raises `InputError` for another number of samples, and for a pose or an outfit that the scene does not have.
    """

    def __init__(
        self,
        bodies: Bodies,
        light: Light | None = None,
        samples: int | None = None,
        device: str | torch.device = "cpu",
        memory_bytes: int = 2 << 30,
        files: DiskCache | None = None,
    ) -> None:
        if samples is not None and samples not in GRIDS:
            raise InputError(f"samples: {samples} per pixel; there are {', '.join(map(str, GRIDS))}")
        self.bodies, self.light, self.samples = bodies, light or Light(), samples or AREA_SAMPLES
        self.by_area = samples is None
        self.device = torch.device(device)
        # A copy, always: torch takes no arrays that cannot be written to.
        put = lambda array, dtype: torch.tensor(np.ascontiguousarray(array), dtype=dtype, device=self.device)
        self._triangles = put(bodies.triangles.T, torch.int64)
        self._triangle_face = put(bodies.triangle_face, torch.int64)
        self._colors = put(bodies.face_colors, torch.float32)
        images = [bodies.texture_of(outfit) for outfit in range(bodies.outfit_count)]
        self._textures = [None if image is None else put(image, torch.uint8) for image in images]
        textured = any(image is not None for image in images)
        self._corner_uv = put(bodies.uv[bodies.triangle_uv].T, torch.float32) if textured else None
        self._normals = NormalOperator(self._triangles, bodies.vertex_count)
        self._split_faces = not np.array_equal(bodies.triangle_face, np.arange(bodies.triangle_count))
        closed = is_closed(bodies.triangles)
        self._outward = np.asarray(is_outward(bodies)) if closed else np.zeros(bodies.pose_count, bool)
        self._kept = MemoryCache(memory_bytes)
        recipe = (self.light, self.samples, self.by_area)
        self._stored = None if files is None else StoredViews(files, bodies, recipe, textured, self.device)
        self._batch_numbers = BATCH_NUMBERS.get(self.device.type, BATCH_NUMBERS["cpu"])

    def view(self, pose: int, camera: Camera) -> View:
        """The view, from memory or the files where it was built before."""
        return self.views([(pose, camera)])[0]

    def views(self, wanted: Sequence[tuple[int, Camera]]) -> list[View]:
        """Many views; those not built before are built together, image size by image size."""
        found = {key: self._find(*key) for key in wanted}
        for part in self.batches([key for key, view in found.items() if view is None]):
            for key, view in zip(part, self.build(part), strict=True):
                found[key] = self._kept.put(("view", *key), view)
                if self._stored is not None:
                    self._stored.put(*key, view)
        return [found[key] for key in wanted]

    def _find(self, pose: int, camera: Camera) -> View | None:
        view = self._kept.get(("view", pose, camera))
        if view is None and self._stored is not None:
            view = self._stored.get(pose, camera)
            return None if view is None else self._kept.put(("view", pose, camera), view)
        return view

    def batches(self, wanted: Sequence[tuple[int, Camera]]) -> Iterator[list[tuple[int, Camera]]]:
        """Views cut into parts that `build` takes at once: of one image size, and within the memory set aside."""
        for size in dict.fromkeys((camera.width, camera.height) for _, camera in wanted):
            group = [key for key in wanted if (key[1].width, key[1].height) == size]
            count = max(1, self._batch_numbers // self._cost(size[0] * size[1]))
            yield from (group[start : start + count] for start in range(0, len(group), count))

    def dress(self, pose: int, camera: Camera, logo_faces: object, outfit: int = 0) -> DressedView:
        """The view with everything but the logo's colours (faces [L], int64) filled in from one of the outfits."""
        faces = np.ascontiguousarray(logo_faces, np.int64)
        key = ("dressed", pose, camera, outfit, faces.tobytes())
        dressed = self._kept.get(key)
        if dressed is None:
            if not 0 <= outfit < self.bodies.outfit_count:
                raise InputError(f"outfit {outfit}: the scene has {self.bodies.outfit_count}")
            view = self.view(pose, camera)
            logo = torch.from_numpy(faces).to(self.device)
            texture = self._textures[outfit]
            dressed = self._kept.put(key, dress(view, logo, self._colors[outfit], self.light.color, texture))
        return dressed

    def build(self, wanted: Sequence[tuple[int, Camera]]) -> list[View]:
        """Rasterize and light views of one image size, all at once, without keeping them.

        On the CPU, torch's threads share the views, or the one view's rows.
        """
        count = self._workers(len(wanted))
        if len(wanted) == 1:
            with one_thread():
                return self._build(wanted, count)
        self._get_ready(wanted)
        # A loop gains nothing from many views at once, and one view's memory stays in the cache.
        parts = even(len(wanted), len(wanted) if use_loops(self.device) else count)
        parts = [wanted[part] for part in parts]
        return [view for views in spread(self._build, parts, count) for view in views]

    def _build(self, wanted: Sequence[tuple[int, Camera]], count: int = 1) -> list[View]:
        screen = self.screen(wanted)
        normals, lights = self._view_space_light(wanted)
        if use_loops(self.device):
            about = (
                self._triangles,
                self._triangle_face,
                normals,
                lights,
                self.light,
                self._corner_uv,
                self._split_faces,
            )
            bands = spread(lambda band: self._band(wanted, screen, band), self._bands(screen, count), count)
            return [view_by_loops(bands, screen, *about, count)]

        def lit(band: Window) -> Lit:
            found = self._band(wanted, screen, band)
            light = light_fragments(found, screen, self._triangles, normals, lights, self.light, self._corner_uv)
            face = self._triangle_face.index_select(0, found.triangle)
            return Lit(found.view, found.pixel, found.area, face, *light)

        parts = spread(lit, self._bands(screen, count), count)
        return assemble(Lit.join(parts), screen, self._split_faces)

    def screen(self, wanted: Sequence[tuple[int, Camera]]) -> Screen:
        """The views' vertices on the screen."""
        with one_thread():
            poses = [self._pose(pose) for pose, _ in wanted]
            only = len(poses) == 1
            vertices = poses[0].vertices.unsqueeze(0) if only else torch.stack([pose.vertices for pose in poses])
            pivots = [camera.pivot or pose.center for pose, (_, camera) in zip(poses, wanted, strict=True)]
            return project(vertices, [camera for _, camera in wanted], pivots)

    def visibility(
        self, wanted: Sequence[tuple[int, Camera]], screen: Screen, window: Window | None = None
    ) -> Visibility:
        """The nearest triangle at every sample."""
        count, cull = self._workers(len(wanted)), self._cull(wanted, screen)
        with one_thread():
            return rasterize(screen, self._triangles, GRIDS[self.samples], cull, window, count)

    def visible(self, wanted: Sequence[tuple[int, Camera]]) -> Visibility | list[Fragments]:
        """What is seen, without its light: samples, or where coverage is measured by area, fragments, in parts."""
        if not self.by_area:
            return self.visibility(wanted, self.screen(wanted))
        self._get_ready(wanted)
        count = self._workers(len(wanted))
        if len(wanted) > 1:
            parts = [(part := wanted[views], self.screen(part), None) for views in even(len(wanted), count)]
        else:
            screen = self.screen(wanted)
            parts = [(wanted, screen, band) for band in self._bands(screen, count)]
        return spread(lambda part: self._band(*part), parts, count)

    def _workers(self, views: int) -> int:
        """How many CPU threads share the work: for one view of few samples one alone is quicker than two that wait
        for each other's Python."""
        return 1 if views == 1 and self.samples in (1, 4) else workers(self.device)

    def _cull(self, wanted: Sequence[tuple[int, Camera]], screen: Screen) -> Bool[Tensor, " B"]:
        """Bodies whose closed surface faces outwards drop their back faces, except in views where the near plane cuts
        them open."""
        cull = torch.from_numpy(self._outward[[pose for pose, _ in wanted]])
        if screen.safe is not None:
            cull &= (screen.view[2] >= screen.near).all(1).cpu()
        return cull

    def _get_ready(self, wanted: Sequence[tuple[int, Camera]]) -> None:
        """The poses, before several threads ask for them at once."""
        for pose, _ in wanted:
            self._pose(pose)

    def _bands(self, screen: Screen, count: int) -> list[Window]:
        """One view's window in bands for so many threads, each small enough for the memory set aside."""
        window = bounding_window(screen)
        height = window.y1 - window.y0
        if len(screen.x) > 1 or not height:
            return [window]
        rows = max(1, self._batch_numbers * height // max(1, self._cost(height * (window.x1 - window.x0))))
        if self.by_area:  # those are cut further by what triangles touch
            rows = height
        cut = lambda band: [replace(band, y0=y, y1=min(y + rows, band.y1)) for y in range(band.y0, band.y1, rows)]
        return [part for band in row_bands(screen, window, count) for part in cut(band)]

    def _cost(self, pixels: int) -> int:
        """What building one view takes, in numbers of 8 bytes held at once: samples, or pieces of triangles."""
        if not self.by_area:
            return pixels * self.samples
        return 2 * pixels + PIECE_COST * self._triangles.shape[1]

    def _band(self, wanted: Sequence[tuple[int, Camera]], screen: Screen, window: Window | None) -> Fragments:
        window = window or bounding_window(screen)
        if self.by_area:
            return area_fragments(screen, self._triangles, self._cull(wanted, screen), window)
        return merge_samples(self.visibility(wanted, screen, window))

    def _view_space_light(self, wanted: Sequence[tuple[int, Camera]]) -> tuple[Tensor, Tensor]:
        """Vertex normals [3, B, V] and light positions [3, B], both turned into each view's space, float32."""
        normals, lights = [], []
        for pose_index, camera in wanted:
            pose = self._pose(pose_index)
            right, up, back = camera.axes
            axes = (right, up, tuple(-b for b in back))
            position = camera.position(camera.pivot or pose.center)
            offset = [a - b for a, b in zip(self.light.position, position, strict=True)]
            lights.append([sum(a * o for a, o in zip(axis, offset, strict=True)) for axis in axes])
            rotation = torch.tensor(axes, dtype=torch.float32).to(self.device)
            normals.append(rotation @ pose.normals)
        return torch.stack(normals, 1), torch.tensor(lights, dtype=torch.float32).to(self.device).T

    def _pose(self, index: int) -> _Pose:
        pose = self._kept.get(("pose", index))
        if pose is None:
            if not 0 <= index < self.bodies.pose_count:
                raise InputError(f"pose {index}: the scene has {self.bodies.pose_count}")
            vertices = torch.from_numpy(self.bodies.vertices[index].T.astype(np.float64)).to(self.device).contiguous()
            low, high = (
                self.bodies.vertices[index].min(0, initial=np.inf),
                self.bodies.vertices[index].max(0, initial=-np.inf),
            )
            center = tuple(((low.astype(np.float64) + high) / 2).tolist()) if vertices.shape[1] else (0.0, 0.0, 0.0)
            pose = self._kept.put(("pose", index), _Pose(vertices, self._normals(vertices), center))
        return pose


@dataclass(frozen=True, eq=False)
class _Pose:
    vertices: Float64[Tensor, "3 V"]
    normals: Float32[Tensor, "3 V"]
    center: Vector
    """Of the bounding box."""
