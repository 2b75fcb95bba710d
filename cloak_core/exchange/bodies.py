"""One topology in many poses, and the areas and normals of its faces, about which trainer and Blender have to agree."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..files.errors import InputError
from ..files.identity import sha256_arrays, sha256_record
from .checks import check_finite, check_indices, checked, frozen

MAX_FACES = 1 << 24
MAX_POSES = 1 << 20


@dataclass(frozen=True, eq=False)
class Bodies:
    """One topology in many poses: the scene as arrays (P poses, V vertices, T triangles, F polygons, K outfits).

    A face is a polygon, by its index in Blender. Polygons were triangulated once, in the first pose.
    Construction checks shapes, ranges and finiteness and raises `InputError`. The arrays cannot be written to, so that
    what is known of them stays true; an array that somebody else could still write to is copied (see `frozen`).
    """

    vertices: np.ndarray
    """[P, V, 3] float32, metres."""
    triangles: np.ndarray
    """[T, 3] int32 vertex indices, counter-clockwise seen from outside."""
    triangle_face: np.ndarray | None = None
    """[T] int32: the polygon of each triangle; identity where absent."""
    face_colors: np.ndarray | None = None
    """[K, F, 3] float32 sRGB in [0, 1], K outfits; mid-grey where absent."""
    regions: dict[str, np.ndarray] = field(default_factory=dict)
    """Named sets of faces, each a bool [F]."""
    names: tuple[str, ...] = ()
    """The poses' names, P of them."""
    loop_total: np.ndarray | None = None
    """[F] int32: corners of each polygon; absent where every polygon is its triangle."""
    loop_vertices: np.ndarray | None = None
    """[sum of loop_total] int32: the polygons' vertex loops, one after the other."""
    uv: np.ndarray | None = None
    """[U, 2] float32 texture coordinates, v up."""
    triangle_uv: np.ndarray | None = None
    """[T, 3] int32 into `uv`."""
    textures: dict[str, np.ndarray] = field(default_factory=dict)
    """Named images, uint8 [H, W, 3], row 0 at the top."""
    outfit_textures: tuple[str, ...] = ()
    """For each outfit the name of the texture it wears, "" for one of plain faces; empty where all are plain. The
    `face_colors` of a textured outfit are the texture's means over the faces, for whoever needs one colour a face."""
    laid_out: np.ndarray | None = None
    """[V, 3] float32: the pose in which cloth is laid onto the bodies; the first of `vertices` where absent."""
    name: str = "scene"
    """Of the scene."""
    recorded_topology: str | None = None
    """The hash its file records, for scenes whose polygons' loops are not stored."""

    def __post_init__(self) -> None:
        self._take("vertices", np.float32, (None, None, 3))
        self._take("triangles", np.int32, (None, 3))
        if not 1 <= self.pose_count <= MAX_POSES:
            raise InputError(f"vertices: {self.pose_count or 'no'} poses, and 1 to {MAX_POSES} are taken")
        if self.triangle_count > MAX_FACES:
            raise InputError(f"triangles: {self.triangle_count} are beyond any mesh ({MAX_FACES})")
        check_finite(self.vertices, "vertices", ("pose", "vertex"))
        check_indices(self.triangles, self.vertex_count, "triangles", "vertices")
        self._take("laid_out", np.float32, (self.vertex_count, 3))
        if self.laid_out is not None:
            check_finite(self.laid_out, "laid_out", ("vertex",))
        names = tuple(map(str, self.names)) or tuple(f"pose {i}" for i in range(self.pose_count))
        if len(names) != self.pose_count:
            raise InputError(f"names: {len(names)} for {self.pose_count} poses")
        object.__setattr__(self, "names", names)
        self._take_faces()
        self._take_looks()

    def _take(self, name: str, dtype: type, shape: tuple[int | None, ...], default: np.ndarray | None = None) -> None:
        """Make a field the array that it is documented to be, where there is any."""
        value = default if getattr(self, name) is None else getattr(self, name)
        if value is not None:
            object.__setattr__(self, name, checked(value, dtype, name, shape))

    def _take_faces(self) -> None:
        """Which triangles each polygon was cut into, and its corners."""
        self._take("triangle_face", np.int32, (self.triangle_count,), default=np.arange(self.triangle_count))
        if self.triangle_count and self.triangle_face.max() >= MAX_FACES:
            raise InputError(f"triangle_face: face {self.triangle_face.max()} is beyond any mesh ({MAX_FACES} faces)")
        if (self.loop_total is None) != (self.loop_vertices is None):
            raise InputError("loop_total and loop_vertices come together")
        if self.loop_total is None:
            return
        self._take("loop_total", np.int32, (None,))
        self._take("loop_vertices", np.int32, (None,))
        check_indices(self.triangle_face, self.face_count, "triangle_face", "faces")
        if self.loop_total.size and self.loop_total.min() < 3:
            raise InputError(f"loop_total: polygon {int(self.loop_total.argmin())} has fewer than 3 corners")
        if int(self.loop_total.sum(dtype=np.int64)) != len(self.loop_vertices):
            raise InputError("loop_vertices: its length is not the sum of loop_total")
        check_indices(self.loop_vertices, self.vertex_count, "loop_vertices", "vertices")

    def _take_looks(self) -> None:
        """Colours, regions, texture coordinates and textures."""
        faces = self.face_count
        self._take("face_colors", np.float32, (None, faces, 3), default=np.full((1, faces, 3), 0.5, np.float32))
        if not self.outfit_count:
            raise InputError("face_colors: no outfit")
        check_finite(self.face_colors, "face_colors", ("outfit", "face"))
        if self.face_colors.size and not (0 <= self.face_colors.min() and self.face_colors.max() <= 1):
            raise InputError("face_colors: values outside [0, 1]")
        if self.uv is not None:
            if self.triangle_uv is None:
                raise InputError("uv without triangle_uv")
            self._take("uv", np.float32, (None, 2))
            self._take("triangle_uv", np.int32, (self.triangle_count, 3))
            check_finite(self.uv, "uv", ("coordinate",))
            check_indices(self.triangle_uv, len(self.uv), "triangle_uv", "uv")
        regions = {key: checked(value, np.bool_, f"region_{key}", (faces,)) for key, value in self.regions.items()}
        textures = {k: checked(v, np.uint8, f"texture_{k}", (None, None, 3)) for k, v in self.textures.items()}
        worn = tuple(map(str, self.outfit_textures)) if any(self.outfit_textures) else ()
        for key, value in (("regions", regions), ("textures", textures), ("outfit_textures", worn)):
            object.__setattr__(self, key, value)
        if worn and len(worn) != self.outfit_count:
            raise InputError(f"outfit_textures: {len(worn)} for {self.outfit_count} outfits")
        for name, image in textures.items():
            if not image.size:
                raise InputError(f"texture_{name}: no pixels")
        for name in filter(None, worn):
            if name not in textures:
                raise InputError(f"outfit_textures: there is no texture '{name}'")
            if self.uv is None:
                raise InputError(f"texture '{name}': the mesh has no texture coordinates (UVs)")

    @property
    def pose_count(self) -> int:
        """How many poses there are."""
        return len(self.vertices)

    @property
    def vertex_count(self) -> int:
        """Vertices of one pose."""
        return self.vertices.shape[1]

    @property
    def triangle_count(self) -> int:
        """Triangles of one pose."""
        return len(self.triangles)

    @cached_property
    def face_count(self) -> int:
        """Faces: polygons where they are stored, else triangles."""
        if self.loop_total is not None:
            return len(self.loop_total)
        return int(self.triangle_face.max()) + 1 if len(self.triangle_face) else 0

    @property
    def outfit_count(self) -> int:
        """How many sets of face colours there are."""
        return len(self.face_colors)

    @cached_property
    def topology(self) -> str:
        """SHA-256 over the polygons' vertex loops: the same in every pose and under every triangulation."""
        if self.loop_total is not None:
            return topology_hash(self.vertex_count, self.loop_total, self.loop_vertices)
        if np.array_equal(self.triangle_face, np.arange(self.triangle_count)):
            return topology_hash(self.vertex_count, np.full(self.triangle_count, 3), self.triangles.ravel())
        # Polygons whose loops nobody stored: the file's word, else the triangles that stand for them.
        return self.recorded_topology or sha256_arrays(self.triangles, self.triangle_face)

    def texture_of(self, outfit: int) -> np.ndarray | None:
        """The picture that an outfit wears, uint8 [H, W, 3]; None for one of plain faces."""
        name = self.outfit_textures[outfit] if self.outfit_textures else ""
        return self.textures[name] if name else None

    @cached_property
    def pose_hashes(self) -> tuple[str, ...]:
        """SHA-256 (hex) of every pose's vertices."""
        return tuple(sha256_arrays(vertices) for vertices in self.vertices)

    @cached_property
    def identity(self) -> str:
        """SHA-256 (hex) of all that images of these bodies depend on: names and regions do not count."""
        names = ("triangles", "triangle_face", "face_colors", "uv", "triangle_uv", "laid_out")
        arrays = {key: getattr(self, key) for key in names}
        hashes = {key: sha256_arrays(array) for key, array in arrays.items() if array is not None}
        worn = [self.texture_of(outfit) for outfit in range(self.outfit_count)]
        textures = ["" if image is None else sha256_arrays(image) for image in worn]
        return sha256_record(hashes | {"topology": self.topology, "poses": self.pose_hashes, "textures": textures})

    def __setstate__(self, state: dict) -> None:
        """Arrays come back from another process writable: they are frozen again."""
        for array in [*state.values(), *state["regions"].values(), *state["textures"].values()]:
            if isinstance(array, np.ndarray):
                frozen(array)
        for name, value in state.items():
            object.__setattr__(self, name, value)

    def for_cloth(self) -> Bodies:
        """The same bodies in the one pose in which cloth is laid onto them."""
        pose = self.vertices[:1] if self.laid_out is None else self.laid_out[None]
        return replace(self, vertices=frozen(pose), names=("laid out",), recorded_topology=self.topology)

    def select_poses(self, indices: object) -> Bodies:
        """The same bodies with only these poses (indices, in this order)."""
        indices = np.atleast_1d(np.asarray(indices, np.int64))
        names = tuple(self.names[i] for i in indices)
        return replace(self, vertices=frozen(self.vertices[indices]), names=names, recorded_topology=self.topology)


def topology_hash(vertex_count: int, loop_total: np.ndarray, loop_vertices: np.ndarray) -> str:
    """SHA-256 (hex) of polygons given as corner counts [F] and concatenated vertex loops."""
    digest = hashlib.sha256(b"cloak topology 1\n" + str(int(vertex_count)).encode() + b"\n")
    for array in (loop_total, loop_vertices):
        digest.update(np.ascontiguousarray(array, "<i4").tobytes())
    return digest.hexdigest()


def area_vectors(bodies: Bodies, pose: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute each triangle's normal times its area [T, 3], and its centroid [T, 3]; float64."""
    corners = bodies.vertices[pose][bodies.triangles].astype(np.float64)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    return np.cross(b - a, c - a) / 2, corners.mean(axis=1)


def sum_by_face(bodies: Bodies, values: np.ndarray) -> np.ndarray:
    """Sum per-triangle values over each face."""
    total = np.zeros((bodies.face_count, *values.shape[1:]))
    np.add.at(total, bodies.triangle_face, values)
    return total


def face_normals(bodies: Bodies) -> np.ndarray:
    """Compute unit normals [F, 3] in the first pose: outwards where corners turn counter-clockwise.

    Zero for a face without area.
    """
    vectors, _ = area_vectors(bodies, 0)
    normal = sum_by_face(bodies, vectors)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
