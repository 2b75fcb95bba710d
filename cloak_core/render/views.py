"""Views as sparse matrices, built once and kept.

A view is one pose seen by one camera: for each covered pixel, how much of which face's colour it shows. Dressing a
view for a logo folds everything that is not the logo into a constant base image; rendering a dressed view is a sparse
product (see compositing.py).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from torch import Tensor

from cloak_core.errors import InputError
from cloak_core.render.area import SIDE, area_fragments
from cloak_core.render.fragments import Fragments, light_fragments, merge_samples
from cloak_core.render.projection import Screen, project
from cloak_core.render.rasterizer import Visibility, Window, bounding_window, rasterize
from cloak_core.render.shading import Light, NormalOperator
from cloak_core.render.sparse import csr, offsets
from cloak_core.render.texture import look_up
from cloak_core.render.threads import one_thread
from cloak_core.scene.bodies import is_closed, is_outward
from cloak_core.scene.cameras import Camera, Vector
from cloak_core.scene.exchange import Bodies

GRIDS = {1: 1, 4: 2, 16: 4, 64: 8}
"""Samples per pixel, and how many of them stand along a pixel's side."""
AREA_SAMPLES = SIDE * SIDE
"""Samples per pixel, in doubtful pixels alone, where coverage is measured by area."""
BATCH_NUMBERS = {"cpu": 1 << 21, "cuda": 1 << 25}
"""Numbers of 8 bytes held at once while views are built; more on the CPU leave its caches and take longer."""
PIECE_COST = 16
"""Numbers held for each triangle where coverage is measured by area."""


@dataclass(frozen=True, eq=False)
class View:
    """One pose seen by one camera: N covered pixels, E fragments, as a sparse matrix pixels x faces (CSR)."""

    height: int
    width: int
    pixels: Int64[Tensor, " N"]
    """Flat index y * W + x, ascending."""
    coverage: Float32[Tensor, " N"]
    """Share of the pixel that the body covers, in (0, 1]."""
    specular: Float32[Tensor, " N"]
    """Highlight, the same in all channels."""
    crow: Int64[Tensor, " N1"]
    """N + 1 row offsets."""
    face: Int64[Tensor, " E"]
    weight: Float32[Tensor, " E"]
    """What a face's colour is multiplied by: its share of the pixel times its light."""
    uv: Float32[Tensor, "2 E"] | None = None
    """Where bodies have textures: texture coordinates in the middle of what is seen of the triangle in the pixel;
    there is an entry for each triangle of a face then."""

    @cached_property
    def box(self) -> tuple[int, int, int, int]:
        """(x0, y0, x1, y1) of the pixels at least half covered, x1 and y1 exclusive; zeros where there are none."""
        return _box(self.pixels, self.coverage, self.width)


@dataclass(frozen=True, eq=False)
class DressedView:
    """A view with everything but the logo's colours filled in: N covered pixels.

    They are ordered by what a render has to do with them: first the M that the logo touches, then, up to
    `front_count`, the others at whose edge the background shows, then the rest.
    """

    height: int
    width: int
    pixels: Int64[Tensor, " N"]
    coverage: Float32[Tensor, " N"]
    planes: Float32[Tensor, "3 N"]
    """The other faces and the highlight, in the light's colour; not clamped."""
    front_count: int
    logo_crow: Int64[Tensor, " M1"]
    """M + 1 row offsets of the logo's matrix, logo pixels x logo faces."""
    logo_face: Int64[Tensor, " E"]
    """Position in the list of logo faces, 0 .. L - 1."""
    logo_weight: Float32[Tensor, " E"]
    logo_count: int
    """L."""
    light_color: Vector
    box: tuple[int, int, int, int]

    @property
    def base(self) -> Float32[Tensor, "N 3"]:
        """`planes` pixel by pixel."""
        return self.planes.T

    @property
    def logo_pixels(self) -> int:
        """M."""
        return len(self.logo_crow) - 1

    @property
    def logo_rows(self) -> Int64[Tensor, " M"]:
        """Rows of `pixels` that the logo touches: the first M."""
        return torch.arange(self.logo_pixels, device=self.pixels.device)

    @cached_property
    def transposed(self) -> tuple[Int64[Tensor, " L1"], Int64[Tensor, " E"], Float32[Tensor, " E"]]:
        """The logo's matrix the other way round, faces x logo pixels: row offsets, logo pixel, weight."""
        row = torch.repeat_interleave(self.logo_crow.diff(), output_size=len(self.logo_face))
        order = torch.argsort(self.logo_face, stable=True)
        crow = offsets(self.logo_face, self.logo_count)
        return crow, row.index_select(0, order), self.logo_weight.index_select(0, order)


class ViewBank:
    """Builds views of bodies and keeps the latest ones, up to a budget of memory.

    bodies: the scene; light: see `Light`; memory_bytes: for kept views. samples: where absent, coverage is measured by
    exact area (see area.py), the best there is for its time (docs/accuracy.md); 1, 4, 16 or 64 count samples instead.
    Raises `InputError` for another number of samples, and for a pose or an outfit that the scene does not have.
    """

    def __init__(
        self,
        bodies: Bodies,
        light: Light | None = None,
        samples: int | None = None,
        device: str | torch.device = "cpu",
        memory_bytes: int = 2 << 30,
    ) -> None:
        if samples is not None and samples not in GRIDS:
            raise InputError(f"samples: {samples} per pixel; there are {', '.join(map(str, GRIDS))}")
        self.bodies, self.light, self.samples = bodies, light or Light(), samples or AREA_SAMPLES
        self.by_area = samples is None
        self.device = torch.device(device)
        put = lambda array, dtype: torch.from_numpy(np.ascontiguousarray(array)).to(self.device, dtype)
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
        self._kept = _Kept(memory_bytes)
        self._batch_numbers = BATCH_NUMBERS.get(self.device.type, BATCH_NUMBERS["cpu"])

    def view(self, pose: int, camera: Camera) -> View:
        """The view, from memory where it was built before."""
        return self.views([(pose, camera)])[0]

    def views(self, wanted: Sequence[tuple[int, Camera]]) -> list[View]:
        """Many views; those not in memory are built together, image size by image size."""
        found = {key: self._kept.get(("view", *key)) for key in wanted}
        for part in self.batches([key for key, view in found.items() if view is None]):
            for key, view in zip(part, self.build(part), strict=True):
                found[key] = self._kept.put(("view", *key), view)
        return [found[key] for key in wanted]

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

    @one_thread()
    def build(self, wanted: Sequence[tuple[int, Camera]]) -> list[View]:
        """Rasterize and light views of one image size, all at once, without keeping them."""
        screen = self.screen(wanted)
        fragments = self._fragments(wanted, screen)
        normals, lights = self._view_space_light(wanted)
        weight, highlight, uv = light_fragments(
            fragments, screen, self._triangles, normals, lights, self.light, self._corner_uv
        )
        face = self._triangle_face.index_select(0, fragments.triangle)
        return _assemble(fragments, face, weight, highlight, uv, screen, self._split_faces)

    @one_thread()
    def screen(self, wanted: Sequence[tuple[int, Camera]]) -> Screen:
        """The views' vertices on the screen."""
        poses = [self._pose(pose) for pose, _ in wanted]
        vertices = poses[0].vertices.unsqueeze(0) if len(poses) == 1 else torch.stack([pose.vertices for pose in poses])
        pivots = [camera.pivot or pose.center for pose, (_, camera) in zip(poses, wanted, strict=True)]
        return project(vertices, [camera for _, camera in wanted], pivots)

    @one_thread()
    def visibility(
        self, wanted: Sequence[tuple[int, Camera]], screen: Screen, window: Window | None = None
    ) -> Visibility:
        """The nearest triangle at every sample."""
        return rasterize(screen, self._triangles, GRIDS[self.samples], self._cull(wanted, screen), window)

    @one_thread()
    def visible(self, wanted: Sequence[tuple[int, Camera]]) -> Visibility | Fragments:
        """What is seen, without its light: samples, or where coverage is measured by area, fragments."""
        screen = self.screen(wanted)
        return self._fragments(wanted, screen) if self.by_area else self.visibility(wanted, screen)

    def _cull(self, wanted: Sequence[tuple[int, Camera]], screen: Screen) -> Bool[Tensor, " B"]:
        """Bodies whose closed surface faces outwards drop their back faces, except in views where the near plane cuts
        them open."""
        cull = torch.from_numpy(self._outward[[pose for pose, _ in wanted]])
        if screen.safe is not None:
            cull &= (screen.view[2] >= screen.near).all(1).cpu()
        return cull

    def _fragments(self, wanted: Sequence[tuple[int, Camera]], screen: Screen) -> Fragments:
        window = bounding_window(screen)
        height = max(1, window.y1 - window.y0)
        per_row = max(1, self._cost(height * (window.x1 - window.x0)) // height)
        rows = max(1, self._batch_numbers // per_row)
        if rows >= window.y1 - window.y0 or len(screen.x) > 1:
            return self._band(wanted, screen, window)
        tops = range(window.y0, window.y1, rows)  # one large view, band by band
        bands = [replace(window, y0=y, y1=min(y + rows, window.y1)) for y in tops]
        return Fragments.join([self._band(wanted, screen, band) for band in bands])

    def _cost(self, pixels: int) -> int:
        """What building one view takes, in numbers of 8 bytes held at once: samples, or pieces of triangles."""
        if not self.by_area:
            return pixels * self.samples
        return 2 * pixels + PIECE_COST * self._triangles.shape[1]

    def _band(self, wanted: Sequence[tuple[int, Camera]], screen: Screen, window: Window) -> Fragments:
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


class _Kept:
    """Objects of tensors by key, the least recently used dropped first once they exceed a number of bytes."""

    def __init__(self, limit: int) -> None:
        self.limit, self.bytes = limit, 0
        self._items: OrderedDict[object, tuple[object, int]] = OrderedDict()

    def get(self, key: object) -> object | None:
        if key not in self._items:
            return None
        self._items.move_to_end(key)
        return self._items[key][0]

    def put(self, key: object, item: object) -> object:
        tensors = [value for value in vars(item).values() if isinstance(value, Tensor)]
        size = sum(tensor.numel() * tensor.element_size() for tensor in tensors)
        self._items[key] = (item, size)
        self.bytes += size
        while self.bytes > self.limit and len(self._items) > 1:
            _, (_, freed) = self._items.popitem(last=False)
            self.bytes -= freed
        return item


def dress(
    view: View,
    logo: Int64[Tensor, " L"],
    colors: Float32[Tensor, "F 3"],
    light_color: Vector,
    texture: UInt8[Tensor, "h w 3"] | None = None,
) -> DressedView:
    """Fold all faces but the logo's, in their colours or the texture's, and the highlight into a base image."""
    position = torch.full((len(colors),), -1, dtype=torch.int64, device=logo.device)
    position[logo] = torch.arange(len(logo), device=logo.device)
    place = position.index_select(0, view.face)
    is_logo = place >= 0
    rest = torch.where(is_logo, 0, view.weight)
    if texture is None:
        worn = csr(view.crow, view.face, rest, (len(view.pixels), len(colors))) @ colors
    else:
        entries = torch.arange(len(view.face), device=logo.device)
        worn = csr(view.crow, entries, rest, (len(view.pixels), len(entries))) @ look_up(texture, view.uv)
    tint = torch.tensor(light_color, device=logo.device)
    planes = ((worn + view.specular.unsqueeze(1)) * tint).T
    entry = is_logo.nonzero().view(-1)
    row = torch.repeat_interleave(view.crow.diff(), output_size=len(view.face)).index_select(0, entry)
    per_row = torch.bincount(row, minlength=len(view.pixels))
    kind = torch.where(per_row > 0, 0, torch.where(view.coverage < 1, 1, 2))
    order = torch.argsort(kind, stable=True)
    logo_pixels, edge_pixels, _ = torch.bincount(kind, minlength=3).tolist()
    logo_crow = row.new_zeros(logo_pixels + 1)
    logo_crow[1:] = per_row.index_select(0, order[:logo_pixels]).cumsum(0)
    return DressedView(
        view.height,
        view.width,
        view.pixels.index_select(0, order),
        view.coverage.index_select(0, order),
        planes.index_select(1, order).contiguous(),
        logo_pixels + edge_pixels,
        logo_crow,
        place.index_select(0, entry),
        view.weight.index_select(0, entry),
        len(logo),
        light_color,
        view.box,
    )


def _assemble(
    fragments: Fragments,
    face: Tensor,
    weight: Tensor,
    highlight: Tensor,
    uv: Tensor | None,
    screen: Screen,
    split_faces: bool,
) -> list[View]:
    """Cut the fragments of a batch into its views' matrices."""
    batch, total = len(screen.x), screen.width * screen.height
    place = fragments.view * total + fragments.pixel
    places, row = torch.unique_consecutive(place, return_inverse=True)
    fold = lambda t: torch.zeros(len(places), dtype=t.dtype, device=t.device).index_add_(0, row, t)
    coverage, highlight = fold(fragments.area), fold(highlight)
    if split_faces and uv is None:  # triangles of one polygon may lie far apart on a texture
        row, face, weight = _merge_faces(row, face, weight)
    crow = offsets(row, len(places))
    first = torch.searchsorted(places, torch.arange(batch + 1, device=places.device) * total)
    row_ends, entry_ends = first.tolist(), crow.index_select(0, first).tolist()
    views = []
    for index in range(batch):
        rows = slice(row_ends[index], row_ends[index + 1])
        entries = slice(entry_ends[index], entry_ends[index + 1])
        pixels = places[rows] - index * total
        own_crow = crow[rows.start : rows.stop + 1] - entries.start
        parts = (t.clone() for t in (coverage[rows], highlight[rows]))
        matrix = [t[..., entries].clone() if t is not None else None for t in (face, weight, uv)]
        views.append(View(screen.height, screen.width, pixels, *parts, own_crow, *matrix))
    return views


def _merge_faces(row: Tensor, face: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sum the weights of a polygon's triangles within each pixel."""
    count = int(face.max()) + 1 if len(face) else 1
    entry, inverse = torch.unique(row * count + face, return_inverse=True)
    row = torch.div(entry, count, rounding_mode="floor")
    return row, entry - row * count, weight.new_zeros(len(entry)).index_add_(0, inverse, weight)


def _box(pixels: Tensor, coverage: Tensor, width: int) -> tuple[int, int, int, int]:
    inside = pixels[coverage >= 0.5]
    if not len(inside):
        return 0, 0, 0, 0
    y = torch.div(inside, width, rounding_mode="floor")
    x = inside - y * width
    x0, x1, y0, y1 = torch.stack([x.min(), x.max(), y.min(), y.max()]).tolist()
    return x0, y0, x1 + 1, y1 + 1
