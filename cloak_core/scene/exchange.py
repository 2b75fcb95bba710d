"""The file formats Cloak and Blender share: scenes, face lists, colours.

Numpy and the standard library only, and no import from the rest of the project: the Blender extension ships this very
file. Everything read here may come from strangers, so nothing is unpickled, sizes are checked before memory is taken,
and whatever is wrong is said in one line that names the file (`InputError`). Everything written appears whole or not
at all.

Conventions: metres, right-handed, y up, bodies facing +z; colours are display-referred sRGB in [0, 1].
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import shutil
import tempfile
import tokenize
import zipfile
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

FORMAT_VERSION = 1
MAX_BYTES = 2 << 30
"""No file is read that would take more memory than this."""
MAX_JSON_BYTES = 16 << 20
MAX_FACES = 1 << 24
MAX_HEADER_BYTES = 64 << 10
"""Of a .npy file."""
AXES = "y up, facing +z, right-handed"


class InputError(ValueError):
    """Bad input from the user: one clear line that names the file or option. The command line exits with 2."""


# --- bodies ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Bodies:
    """One topology in many poses: the scene as arrays (P poses, V vertices, T triangles, F polygons, K outfits).

    A face is a polygon, by its index in Blender. Polygons were triangulated once, in the first pose.
    Construction checks shapes, ranges and finiteness and raises `InputError`.
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
    name: str = "scene"
    recorded_topology: str | None = None
    """The hash its file records, for scenes whose polygons' loops are not stored."""

    def __post_init__(self) -> None:
        put = lambda key, value: object.__setattr__(self, key, value)
        put("vertices", _array(self.vertices, np.float32, "vertices", (None, None, 3)))
        put("triangles", _array(self.triangles, np.int32, "triangles", (None, 3)))
        faces = self.triangle_face if self.triangle_face is not None else np.arange(len(self.triangles))
        put("triangle_face", _array(faces, np.int32, "triangle_face", (len(self.triangles),)))
        if len(self.triangle_face) and self.triangle_face.max() >= MAX_FACES:
            raise InputError(f"triangle_face: face {self.triangle_face.max()} is beyond any mesh ({MAX_FACES} faces)")
        if (self.loop_total is None) != (self.loop_vertices is None):
            raise InputError("loop_total and loop_vertices come together")
        if self.loop_total is not None:
            put("loop_total", _array(self.loop_total, np.int32, "loop_total", (None,)))
            put("loop_vertices", _array(self.loop_vertices, np.int32, "loop_vertices", (None,)))
        colors = self.face_colors
        if colors is None:
            colors = np.full((1, self.face_count, 3), 0.5, np.float32)
        put("face_colors", _array(colors, np.float32, "face_colors", (None, self.face_count, 3)))
        regions = {
            key: _array(value, np.bool_, f"region_{key}", (self.face_count,)) for key, value in self.regions.items()
        }
        put("regions", regions)
        names = tuple(str(n) for n in self.names) or tuple(f"pose {i}" for i in range(self.pose_count))
        put("names", names)
        if self.uv is not None:
            put("uv", _array(self.uv, np.float32, "uv", (None, 2)))
            put("triangle_uv", _array(self.triangle_uv, np.int32, "triangle_uv", (len(self.triangles), 3)))
        put("textures", {k: _array(v, np.uint8, f"texture_{k}", (None, None, 3)) for k, v in self.textures.items()})
        put("outfit_textures", tuple(str(n) for n in self.outfit_textures) if any(self.outfit_textures) else ())
        self._check()

    def _check(self) -> None:
        if not self.pose_count:
            raise InputError("vertices: no pose")
        if not len(self.face_colors):
            raise InputError("face_colors: no outfit")
        if len(self.names) != self.pose_count:
            raise InputError(f"names: {len(self.names)} for {self.pose_count} poses")
        _finite(self.vertices, "vertices", ("pose", "vertex"))
        _finite(self.face_colors, "face_colors", ("outfit", "face"))
        if self.face_colors.size and not (0 <= self.face_colors.min() and self.face_colors.max() <= 1):
            raise InputError("face_colors: values outside [0, 1]")
        _indices(self.triangles, self.vertex_count, "triangles", "vertices")
        _indices(self.triangle_face, self.face_count, "triangle_face", "faces")
        if self.loop_total is not None:
            if self.loop_total.size and self.loop_total.min() < 3:
                raise InputError(f"loop_total: polygon {int(self.loop_total.argmin())} has fewer than 3 corners")
            if int(self.loop_total.sum(dtype=np.int64)) != len(self.loop_vertices):
                raise InputError("loop_vertices: its length is not the sum of loop_total")
            _indices(self.loop_vertices, self.vertex_count, "loop_vertices", "vertices")
        if self.uv is not None:
            _finite(self.uv, "uv", ("coordinate",))
            _indices(self.triangle_uv, len(self.uv), "triangle_uv", "uv")
        self._check_textures()

    def _check_textures(self) -> None:
        if self.outfit_textures and len(self.outfit_textures) != self.outfit_count:
            raise InputError(f"outfit_textures: {len(self.outfit_textures)} for {self.outfit_count} outfits")
        for name, image in self.textures.items():
            if not image.size:
                raise InputError(f"texture_{name}: no pixels")
        for name in filter(None, self.outfit_textures):
            if name not in self.textures:
                raise InputError(f"outfit_textures: there is no texture '{name}'")
            if self.uv is None:
                raise InputError(f"texture '{name}': the mesh has no texture coordinates (UVs)")

    @property
    def pose_count(self) -> int:
        return len(self.vertices)

    @property
    def vertex_count(self) -> int:
        return self.vertices.shape[1]

    @property
    def triangle_count(self) -> int:
        return len(self.triangles)

    @cached_property
    def face_count(self) -> int:
        if self.loop_total is not None:
            return len(self.loop_total)
        return int(self.triangle_face.max()) + 1 if len(self.triangle_face) else 0

    @property
    def outfit_count(self) -> int:
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

    def select_poses(self, indices: object) -> Bodies:
        """The same bodies with only these poses (indices, in this order)."""
        indices = np.atleast_1d(np.asarray(indices, np.int64))
        names = tuple(self.names[i] for i in indices)
        return replace(self, vertices=self.vertices[indices], names=names, recorded_topology=self.topology)


def topology_hash(vertex_count: int, loop_total: np.ndarray, loop_vertices: np.ndarray) -> str:
    """SHA-256 (hex) of polygons given as corner counts [F] and concatenated vertex loops."""
    digest = hashlib.sha256(b"cloak topology 1\n" + str(int(vertex_count)).encode() + b"\n")
    for array in (loop_total, loop_vertices):
        digest.update(np.ascontiguousarray(array, "<i4").tobytes())
    return digest.hexdigest()


def sha256_arrays(*arrays: np.ndarray) -> str:
    """SHA-256 (hex) of arrays: their dtypes, shapes and bytes, in order."""
    digest = hashlib.sha256()
    for array in arrays:
        array = np.ascontiguousarray(array)
        digest.update(f"{array.dtype.str}{array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


# --- scene packages --------------------------------------------------------------------------------------------------


def read_scene(path: str | os.PathLike) -> Bodies:
    """Bodies from a scene package (a folder with scene.json and bodies.npz) or from one .npz with the same arrays."""
    path = Path(path)
    record: dict = {}
    arrays_path = path
    if path.is_dir():
        if not (path / "scene.json").exists():
            raise InputError(f"{path}: not a scene (no scene.json in it)")
        record, arrays_path = read_json(path / "scene.json"), path / "bodies.npz"
        _check_version(record, "cloak scene", path / "scene.json")
    elif not path.exists():
        raise InputError(f"{path}: no such scene")
    arrays = read_npz(arrays_path)
    for key in ("vertices", "triangles"):
        if key not in arrays:
            raise InputError(f"{arrays_path}: not a scene (no array '{key}')")
    try:
        bodies = _bodies_from_arrays(arrays, str(record.get("name", path.stem)), record.get("topology"))
    except InputError as error:
        raise InputError(f"{arrays_path}: {error}") from None
    recorded = record.get("topology", bodies.topology)
    if recorded != bodies.topology:
        raise InputError(f"{path}: scene.json records topology {recorded}, bodies.npz holds {bodies.topology}")
    return bodies


def _bodies_from_arrays(arrays: dict[str, np.ndarray], name: str, topology: object) -> Bodies:
    named = lambda prefix: {k[len(prefix) :]: v for k, v in arrays.items() if k.startswith(prefix)}
    optional = ("triangle_face", "face_colors", "loop_total", "loop_vertices", "uv", "triangle_uv")
    if arrays.get("uv") is not None and "triangle_uv" not in arrays:
        raise InputError("uv without triangle_uv")
    return Bodies(
        vertices=arrays["vertices"],
        triangles=arrays["triangles"],
        **{key: arrays.get(key) for key in optional},
        regions=named("region_"),
        textures=named("texture_"),
        outfit_textures=tuple(str(n) for n in arrays.get("outfit_textures", ())),
        names=tuple(str(n) for n in arrays.get("names", ())),
        name=name,
        recorded_topology=topology if isinstance(topology, str) else None,
    )


def write_scene(folder: str | os.PathLike, bodies: Bodies, creator: str = "cloak") -> Path:
    """Write a scene package; the folder must not exist yet (or be empty). It appears whole or not at all."""
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: exists already")
    arrays = {key: getattr(bodies, key) for key in ("vertices", "triangles", "triangle_face", "face_colors")}
    for key in ("loop_total", "loop_vertices", "uv", "triangle_uv"):
        if getattr(bodies, key) is not None:
            arrays[key] = getattr(bodies, key)
    arrays |= {f"region_{k}": v for k, v in bodies.regions.items()}
    arrays |= {f"texture_{k}": v for k, v in bodies.textures.items()}
    if bodies.outfit_textures:
        arrays["outfit_textures"] = np.array(bodies.outfit_textures, np.str_)
    record = {
        "format": "cloak scene",
        "version": FORMAT_VERSION,
        "name": bodies.name,
        "axes": AXES,
        "unit": "metre",
        "poses": bodies.pose_count,
        "vertices": bodies.vertex_count,
        "triangles": bodies.triangle_count,
        "faces": bodies.face_count,
        "outfits": bodies.outfit_count,
        "topology": bodies.topology,
        "creator": creator,
    }
    with new_folder(folder) as temporary:
        np.savez(temporary / "bodies.npz", names=np.array(bodies.names, np.str_), **arrays)
        (temporary / "scene.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    return folder


# --- face lists ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FaceList:
    """A set of faces as stored in a file."""

    ids: np.ndarray
    """[L] int64, sorted, unique."""
    index_of: str = "polygon"
    """What an id counts: "polygon" (Blender's faces) or "triangle" (the reference project's lists)."""
    topology: str | None = None
    """Hash of the mesh the list was made for, where its sidecar tells."""


def read_face_list(path: str | os.PathLike, bodies: Bodies | None = None) -> FaceList:
    """Read a face list and its sidecar NAME.json; with `bodies`, check it against that mesh.

    Any integer type and order is read. Refused, by name: duplicates, negatives, floats, ids beyond the mesh, a sidecar
    for another topology (both hashes). Without a sidecar a .npy list counts polygons; an .idx list, the reference
    project's, counts triangles.
    """
    path = Path(path)
    array = read_npy(path)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise InputError(f"{path}: a face list is one row of integers, not {array.dtype} of shape {array.shape}")
    if not array.size:
        raise InputError(f"{path}: the face list is empty")
    if array.max() > np.iinfo(np.int32).max:
        raise InputError(f"{path}: face id {array.max()} is beyond any mesh")
    ids, counts = np.unique(array.astype(np.int64), return_counts=True)
    if ids[0] < 0:
        raise InputError(f"{path}: negative face id {ids[0]}")
    if counts.max() > 1:
        raise InputError(f"{path}: duplicate face id {ids[counts.argmax()]} ({counts.max()} times)")
    index_of, topology = "triangle" if path.suffix == ".idx" else "polygon", None
    sidecar = path.with_suffix(".json")
    if sidecar.exists():
        record = read_json(sidecar)
        _check_version(record, "cloak face list", sidecar)
        index_of, topology = record.get("index_of", index_of), record.get("topology")
        if index_of not in ("polygon", "triangle"):
            raise InputError(f"{sidecar}: index_of is {index_of!r}, neither 'polygon' nor 'triangle'")
    face_list = FaceList(ids, index_of, topology)
    if bodies is not None:
        _check_face_list(face_list, bodies, path)
    return face_list


def _check_face_list(face_list: FaceList, bodies: Bodies, path: Path) -> None:
    if face_list.topology not in (None, bodies.topology):
        raise InputError(
            f"{path}: made for topology {face_list.topology}, but scene '{bodies.name}' has {bodies.topology}"
        )
    count = bodies.face_count if face_list.index_of == "polygon" else bodies.triangle_count
    if face_list.ids[-1] >= count:
        raise InputError(f"{path}: {face_list.index_of} id {face_list.ids[-1]} is beyond the mesh's {count}")


def face_ids(face_list: FaceList, bodies: Bodies) -> np.ndarray:
    """[L] int64 sorted polygon ids of a face list; a polygon belongs as soon as one of its triangles is listed."""
    if face_list.index_of == "polygon":
        return face_list.ids
    return np.unique(bodies.triangle_face[face_list.ids]).astype(np.int64)


def write_face_list(path: str | os.PathLike, ids: np.ndarray, topology: str, index_of: str = "polygon") -> Path:
    """Write a face list (one-dimensional int64, sorted, unique) and its sidecar NAME.json, each atomically."""
    path = Path(path)
    ids = np.asarray(ids)
    if ids.ndim != 1 or ids.dtype.kind not in "iu":
        raise InputError(f"{path}: a face list is one row of integers, not {ids.dtype} of shape {ids.shape}")
    if not ids.size:
        raise InputError(f"{path}: the face list would be empty")
    ids = np.unique(ids.astype(np.int64))
    record = {
        "format": "cloak face list",
        "version": FORMAT_VERSION,
        "topology": topology,
        "index_of": index_of,
        "count": len(ids),
    }
    write_json(path.with_suffix(".json"), record)
    write_npy(path, ids)
    return path


# --- colours ---------------------------------------------------------------------------------------------------------


def read_colors(path: str | os.PathLike, count: int | None = None) -> np.ndarray:
    """[L, 3] float32 sRGB in [0, 1]; `count` is the number of faces they must be for."""
    path = Path(path)
    colors = read_npy(path)
    if colors.ndim != 2 or colors.shape[1] != 3 or colors.dtype.kind != "f":
        raise InputError(f"{path}: colours are float [faces, 3], not {colors.dtype} of shape {colors.shape}")
    if count is not None and len(colors) != count:
        raise InputError(f"{path}: colours for {len(colors)} faces, but the logo has {count}")
    if not np.isfinite(colors).all() or (colors.size and (colors.min() < 0 or colors.max() > 1)):
        raise InputError(f"{path}: colours outside [0, 1]")
    return colors.astype(np.float32)


def write_colors(path: str | os.PathLike, colors: np.ndarray) -> None:
    """Replace the file of colours [L, 3] atomically: a reader sees the old ones or the new ones."""
    write_npy(path, np.asarray(colors, np.float32))


# --- files -----------------------------------------------------------------------------------------------------------


def read_json(path: str | os.PathLike) -> dict:
    """A JSON object from a file of bounded size."""
    path = Path(path)
    try:
        if path.stat().st_size > MAX_JSON_BYTES:
            raise InputError(f"{path}: too large for a JSON record")
        record = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not valid JSON ({error})") from None
    if not isinstance(record, dict):
        raise InputError(f"{path}: not a JSON object")
    return record


def read_npy(path: str | os.PathLike) -> np.ndarray:
    """One array from a .npy file; never unpickles, and takes no more memory than the file's own size."""
    path = Path(path)
    try:
        with path.open("rb") as file:
            return _read_array(file, os.fstat(file.fileno()).st_size)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    except (ValueError, EOFError, SyntaxError) as error:
        raise InputError(f"{path}: not a readable .npy array ({_line(error)})") from None


def read_npz(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """All arrays of a .npz file; never unpickles, and refuses what would unpack to more than `MAX_BYTES`."""
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = [m for m in archive.infolist() if m.filename.endswith(".npy")]
            if sum(m.file_size for m in members) > MAX_BYTES:
                raise InputError(f"{path}: would unpack to more than {MAX_BYTES >> 30} GiB")
            arrays = {}
            for member in members:
                with archive.open(member) as file:
                    arrays[member.filename[:-4]] = _read_array(file, member.file_size)
            return arrays
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    except InputError:
        raise
    except (ValueError, EOFError, SyntaxError, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise InputError(f"{path}: not a readable .npz archive ({_line(error)})") from None
    except Exception as error:
        if type(error).__module__ not in ("zlib", "_lzma", "lzma"):
            raise
        raise InputError(f"{path}: not a readable .npz archive ({_line(error)})") from None


def _read_array(file: object, size: int) -> np.ndarray:
    """Like numpy.lib.format.read_array, but checks the declared shape against the bytes there are before allocating."""
    version = np.lib.format.read_magic(file)
    reader = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if reader is None:
        raise ValueError(f"npy version {version}")
    # numpy takes as much memory as the header says it is long, so the length is looked at first.
    size_of_length = 2 if version == (1, 0) else 4
    length = file.read(size_of_length)
    if int.from_bytes(length, "little") > MAX_HEADER_BYTES:
        raise ValueError("its header is too long")
    header = file.read(int.from_bytes(length, "little"))
    try:
        shape, fortran, dtype = reader(io.BytesIO(length + header))
    except (SyntaxError, TypeError, tokenize.TokenError, RecursionError, MemoryError) as error:
        raise ValueError(f"its header is not one ({_line(error)})") from None
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are never loaded")
    count = 1
    for extent in shape:
        count *= extent
    if count < 0 or count * dtype.itemsize > min(size, MAX_BYTES):
        raise ValueError(f"it declares {dtype} of shape {shape}, more than the file holds")
    data = file.read(count * dtype.itemsize)
    if len(data) != count * dtype.itemsize:
        raise ValueError("it is truncated")
    array = np.frombuffer(bytearray(data), dtype)
    return array.reshape(shape[::-1]).T if fortran else array.reshape(shape)


def write_json(path: str | os.PathLike, record: dict) -> None:
    """Replace a JSON file atomically."""
    text = json.dumps(record, indent=2, allow_nan=False) + "\n"
    _replace(Path(path), lambda file: file.write(text.encode()))


def write_npy(path: str | os.PathLike, array: np.ndarray) -> None:
    """Replace a .npy file atomically."""
    _replace(Path(path), lambda file: np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False))


def _replace(path: Path, write: object) -> None:
    """Write beside the file and rename over it: after a crash there is the old file or the new one, never a half."""
    with written(path):
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                write(file)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        finally:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(temporary)


@contextlib.contextmanager
def written(path: str | os.PathLike):
    """Whatever the system has against writing becomes an `InputError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None


@contextlib.contextmanager
def new_folder(folder: Path):
    """Yield a temporary folder beside `folder` that takes its name when the block ends well and vanishes when not."""
    with written(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
        try:
            yield temporary
            os.chmod(temporary, 0o755)
            if folder.exists():
                folder.rmdir()  # empty, or this fails; Windows cannot rename over a folder
            os.replace(temporary, folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


# --- checks ----------------------------------------------------------------------------------------------------------


def _check_version(record: dict, kind: str, path: Path) -> None:
    if record.get("format") != kind:
        raise InputError(f"{path}: not a {kind} (its format is {record.get('format')!r})")
    version = record.get("version")
    if not isinstance(version, int) or version < 1:
        raise InputError(f"{path}: version is {version!r}")
    if version > FORMAT_VERSION:
        raise InputError(f"{path}: version {version} is newer than this Cloak reads ({FORMAT_VERSION})")


def _array(value: object, dtype: type, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    array = np.asarray(value)
    kinds = {"f": "fiu", "i": "iu", "b": "b", "u": "u"}[np.dtype(dtype).kind]
    fits = array.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))
    if not fits or (array.dtype.kind not in kinds and array.size):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        kind = {"f": "numbers", "i": "integers", "b": "booleans", "u": "bytes"}[np.dtype(dtype).kind]
        raise InputError(f"{name}: {array.dtype} of shape {array.shape}, but {kind} of shape ({wanted}) are needed")
    if np.dtype(dtype).kind == "i" and array.size and (array.min() < 0 or array.max() > np.iinfo(np.int32).max):
        raise InputError(f"{name}: an index is negative or beyond 2^31")
    return np.ascontiguousarray(array, dtype)


def _finite(array: np.ndarray, name: str, axes: tuple[str, ...]) -> None:
    if not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0]
        place = ", ".join(f"{axis} {index}" for axis, index in zip(axes, where, strict=False))
        raise InputError(f"{name}: not a finite number at {place}")


def _indices(array: np.ndarray, count: int, name: str, of: str) -> None:
    if array.size and array.max() >= count:
        raise InputError(f"{name}: index {array.max()} is beyond the {count} {of}")


def _line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
