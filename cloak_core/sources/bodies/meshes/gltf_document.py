"""The records and binary values of a glTF file (.glb, .gltf), checked against the bytes there are."""

from __future__ import annotations

import base64
import binascii
import math
import struct
from pathlib import Path

import numpy as np

from cloak_core.core.pictures import MAX_PIXELS, read_picture
from cloak_core.files.errors import InputError
from cloak_core.files.reading import parse_json, read_bytes
from cloak_core.sources.bodies.meshes.mesh_file import MAX_FILE_BYTES, file_beside, to_linear, to_srgb

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
WIDTHS = {"SCALAR": (1,), "VEC2": (2,), "VEC3": (3,), "VEC4": (4,), "MAT4": (4, 4)}
KNOWN_EXTENSIONS = {"KHR_mesh_quantization", "KHR_materials_unlit", "KHR_texture_transform"}
MAX_NODES = 100_000
MAX_VALUES = 1 << 25
"""Of the accessors of all primitives together."""


class Document:
    """The JSON of a glTF file with its binary buffers."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data = read_bytes(path, MAX_FILE_BYTES)
        self.binary = memoryview(b"")
        if data[:4] == b"glTF":
            chunks = glb_chunks(data)
            data = bytes(chunks[b"JSON"])
            self.binary = chunks.get(b"BIN\0", self.binary)
        self.json = parse_json(data, str(path))
        self.buffers: dict[int, memoryview] = {}
        self.base_pictures: list[np.ndarray] = []
        self._values = 0
        self._base_numbers: dict[tuple, int] = {}
        for extension in self.json.get("extensionsRequired", []):
            if extension not in KNOWN_EXTENSIONS:
                raise InputError(f"{path}: needs the extension {extension}, which is not read here")

    def list(self, name: str) -> list:
        return self.json.get(name, [])

    def uri(self, uri: str, what: str) -> bytes:
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2], validate=True)
            except binascii.Error:
                raise InputError(f"{self.path}: {what} is not valid base64") from None
        beside = file_beside(self.path, uri)
        if beside is None:
            raise InputError(f"{self.path}: {what} '{uri}' is not a file in its folder")
        return read_bytes(beside, MAX_FILE_BYTES)

    def view(self, index: int) -> tuple[memoryview, dict]:
        """Give the bytes of a buffer view, and its record."""
        record = self.list("bufferViews")[index]
        number = record["buffer"]
        if number not in self.buffers:
            uri = self.list("buffers")[number].get("uri")
            self.buffers[number] = self.binary if uri is None else memoryview(self.uri(uri, f"buffer {number}"))
        start = record.get("byteOffset", 0)
        length = record["byteLength"]
        data = self.buffers[number]
        if start < 0 or length < 0 or start + length > len(data):
            raise ValueError(f"buffer view {index} reaches beyond its buffer")
        return data[start : start + length], record

    def geometry(self, index: int) -> np.ndarray:
        """Read an accessor that becomes part of the mesh, within a bound: a small file may repeat itself many times."""
        values = self.accessor(index)
        self._values += values.size
        if self._values > MAX_VALUES:
            raise InputError(f"{self.path}: unfolds to more than {MAX_VALUES:,} numbers")
        return values

    def accessor(self, index: int) -> np.ndarray:
        """Read the values of an accessor, [count, ...]; normalised integers as floats."""
        record = self.list("accessors")[index]
        dtype = np.dtype(COMPONENTS[record["componentType"]])
        shape = WIDTHS[record["type"]]
        count = record["count"]
        if "bufferView" in record:
            values = self.strided(record["bufferView"], record.get("byteOffset", 0), dtype, shape, count)
        elif count * math.prod(shape) <= MAX_VALUES:
            values = np.zeros((count, *shape), dtype)
        else:
            raise ValueError(f"accessor {index} is too long")
        if sparse := record.get("sparse"):
            at, new = sparse["indices"], sparse["values"]
            kind = np.dtype(COMPONENTS[at["componentType"]])
            places = self.strided(at["bufferView"], at.get("byteOffset", 0), kind, (1,), sparse["count"])[:, 0]
            values = values.copy()
            values[places] = self.strided(new["bufferView"], new.get("byteOffset", 0), dtype, shape, sparse["count"])
        if record.get("normalized"):
            values = np.maximum(values / np.iinfo(dtype).max, -1)
        return values[:, 0] if shape == (1,) else values

    def strided(self, view: int, offset: int, dtype: np.dtype, shape: tuple[int, ...], count: int) -> np.ndarray:
        data, record = self.view(view)
        width = dtype.itemsize * math.prod(shape)
        stride = record.get("byteStride", width)
        if count < 0 or stride < width or (count and offset + (count - 1) * stride + width > len(data)):
            raise ValueError(f"an accessor reaches beyond buffer view {view}")
        rows = np.ndarray((count, width), np.uint8, data, offset, (stride, 1))
        return np.ascontiguousarray(rows).view(dtype).reshape(count, *shape)

    def mesh_nodes(self) -> list[int]:
        """List the nodes of the default scene that carry a mesh, depth first."""
        nodes = self.list("nodes")
        with_mesh = []
        visited = set()
        scenes = self.list("scenes")
        roots = scenes[self.json.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
        stack = list(reversed(list(roots)))
        while stack:
            index = stack.pop()
            if index in visited or len(visited) > MAX_NODES:
                raise ValueError("its nodes are no tree")
            visited.add(index)
            if "mesh" in nodes[index]:
                with_mesh.append(index)
            stack += reversed(nodes[index].get("children", []))
        if not with_mesh:
            raise InputError(f"{self.path}: no mesh in its scene")
        return with_mesh

    def frame_times(self, frames: int) -> list[float | None]:
        """Choose moments of the first animation in seconds; None is the resting pose."""
        if not frames:
            return [None]
        animations = self.list("animations")
        if not animations:
            raise InputError(f"{self.path}: it has no animation to take {frames} frames from")
        ends = [self.accessor(sampler["input"]) for sampler in animations[0]["samplers"]]
        first, last = min(end.min() for end in ends), max(end.max() for end in ends)
        return np.linspace(float(first), float(last), frames).tolist()

    def base_color(self, material: int | None) -> tuple[np.ndarray, dict | None]:
        """Give a material's linear base colour, and the reference to the texture that it multiplies, or None."""
        record = {} if material is None else self.list("materials")[material].get("pbrMetallicRoughness", {})
        return np.array(record.get("baseColorFactor", (1, 1, 1, 1)), float)[:3], record.get("baseColorTexture")

    def base_picture(self, texture: int, factor: tuple[float, ...]) -> int:
        """Number in `base_pictures` of a texture times a linear colour; -1 where there is no picture in it."""
        key = (texture, factor)
        if key in self._base_numbers:
            return self._base_numbers[key]
        source = self.list("textures")[texture].get("source")
        self._base_numbers[key] = -1 if source is None else len(self.base_pictures)
        if source is not None:
            record = self.list("images")[source]
            data = self.view(record["bufferView"])[0] if "bufferView" in record else self.uri(record["uri"], "image")
            picture = read_picture(Path(f"{self.path}: image {source}"), data=data)
            if factor != (1, 1, 1):
                tinted = to_srgb(to_linear(np.arange(256) / 255)[:, None] * factor)
                table = np.rint(tinted * 255).astype(np.uint8)
                picture = np.stack([table[picture[..., c], c] for c in range(3)], axis=-1)
            self.base_pictures.append(picture)
            if sum(each.size for each in self.base_pictures) > 3 * MAX_PIXELS:
                raise InputError(f"{self.path}: its pictures have more than {MAX_PIXELS:,} pixels")
        return self._base_numbers[key]


def glb_chunks(data: bytes) -> dict[bytes, memoryview]:
    """Find the JSON and the binary chunk of a binary glTF file, the first of each kind."""
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2 or length > len(data):
        raise ValueError("it is truncated" if version == 2 else f"version {version}")
    chunks = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<I4s", data, at)
        if at + 8 + size > length:
            raise ValueError("a chunk is truncated")
        if kind in (b"JSON", b"BIN\0"):
            chunks.setdefault(kind, memoryview(data)[at + 8 : at + 8 + size])
        at += 8 + size
    return chunks
