"""Stanford PLY, ASCII and binary: vertices, polygons as they are, vertex colours and texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_bytes
from cloak_core.scene.meshes.mesh_file import MAX_FILE_BYTES, MeshFile, mean_of_corners

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class Property:
    name: str
    kind: str
    count_kind: str | None = None
    """Type of a list's length; None for a single value."""


@dataclass
class Element:
    name: str
    count: int
    properties: list[Property] = field(default_factory=list)


def read_ply(path: Path) -> MeshFile:
    """Read a PLY file's vertices and faces in their order. Raises `InputError` for what is damaged or no mesh."""
    data = read_bytes(path, MAX_FILE_BYTES)
    try:
        order, elements, start = read_header(data)
        reader = AsciiReader(data[start:]) if not order else BinaryReader(data, start, order)
        values = {element.name: reader.element(element) for element in elements}
        return mesh_of(values)
    except InputError:
        raise
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise InputError(f"{path}: not a readable PLY mesh ({error})") from None


def read_header(data: bytes) -> tuple[str, list[Element], int]:
    """(byte order, elements, where the values begin)."""
    end = data.find(b"end_header")
    start = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or not start:
        raise ValueError("it has no PLY header")
    order, elements = None, []
    for line in data[:end].decode("ascii", "replace").splitlines():
        match line.split():
            case ["format", name, _]:
                order = ORDERS[name]
            case ["element", name, count]:
                elements.append(Element(name, int(count)))
            case ["property", "list", count_kind, kind, name]:
                elements[-1].properties.append(Property(name, TYPES[kind], TYPES[count_kind]))
            case ["property", kind, name]:
                elements[-1].properties.append(Property(name, TYPES[kind]))
    if order is None or any(not 0 <= element.count <= len(data) for element in elements):
        raise ValueError("its header promises more than the file holds")
    return order, elements, start


Values = dict[str, np.ndarray | tuple[np.ndarray, np.ndarray]]


class AsciiReader:
    """Values as words, one element after the other."""

    def __init__(self, data: bytes) -> None:
        self.words, self.at = data.split(), 0

    def take(self, count: int) -> list[bytes]:
        taken = self.words[self.at : self.at + count]
        if len(taken) < count or count < 0:
            raise ValueError("it is truncated")
        self.at += count
        return taken

    def element(self, element: Element) -> Values:
        """Property name -> values [count], or (lengths [count], all values) of a list."""
        singles = all(prop.count_kind is None for prop in element.properties)
        if singles:
            width = len(element.properties)
            table = np.array(self.take(element.count * width)).astype(np.float64).reshape(element.count, width)
            return {prop.name: table[:, i] for i, prop in enumerate(element.properties)}
        found: dict[str, tuple[list, list]] = {prop.name: ([], []) for prop in element.properties}
        for _ in range(element.count):
            for prop in element.properties:
                length = 1 if prop.count_kind is None else int(self.take(1)[0])
                found[prop.name][0].append(length)
                found[prop.name][1].extend(self.take(length))
        return {name: (np.array(n, int), np.array(v).astype(np.float64)) for name, (n, v) in found.items()}


class BinaryReader:
    """Values as bytes, one element after the other."""

    def __init__(self, data: bytes, start: int, order: str) -> None:
        self.data, self.at, self.order = data, start, order

    def take(self, kind: str | np.dtype, count: int) -> np.ndarray:
        dtype = np.dtype(kind)
        if count < 0 or self.at + count * dtype.itemsize > len(self.data):
            raise ValueError("it is truncated")
        values = np.frombuffer(self.data, dtype, count, self.at)
        self.at += count * dtype.itemsize
        return values

    def element(self, element: Element) -> Values:
        """Property name -> values [count], or (lengths [count], all values) of a list."""
        if all(prop.count_kind is None for prop in element.properties):
            table = self.take(self.row_type(element, {}), element.count)
            return {prop.name: table[prop.name].astype(np.float64) for prop in element.properties}
        return self.even_lists(element) or self.uneven_lists(element)

    def row_type(self, element: Element, lengths: dict[str, int]) -> np.dtype:
        fields = []
        for prop in element.properties:
            if prop.count_kind is None:
                fields.append((prop.name, self.order + prop.kind))
            else:
                fields.append((f"{prop.name} length", self.order + prop.count_kind))
                fields.append((prop.name, self.order + prop.kind, (lengths[prop.name],)))
        return np.dtype(fields)

    def even_lists(self, element: Element) -> Values | None:
        """All rows at once, where every list is as long as the first row's; else None, and nothing is taken."""
        start, lengths = self.at, {}
        if not element.count:
            return None
        for prop in element.properties:
            if prop.count_kind is None:
                self.take(self.order + prop.kind, 1)
            else:
                lengths[prop.name] = int(self.take(self.order + prop.count_kind, 1)[0])
                self.take(self.order + prop.kind, lengths[prop.name])
        self.at = start
        dtype = self.row_type(element, lengths)
        if start + element.count * dtype.itemsize > len(self.data):
            return None
        table = self.take(dtype, element.count)
        if any((table[f"{name} length"] != length).any() for name, length in lengths.items()):
            self.at = start
            return None
        return {
            prop.name: (
                np.full(element.count, lengths.get(prop.name, 1)),
                table[prop.name].reshape(-1).astype(np.float64),
            )
            for prop in element.properties
        }

    def uneven_lists(self, element: Element) -> Values:
        found: dict[str, tuple[list, list]] = {prop.name: ([], []) for prop in element.properties}
        for _ in range(element.count):
            for prop in element.properties:
                length = 1 if prop.count_kind is None else int(self.take(self.order + prop.count_kind, 1)[0])
                found[prop.name][0].append(length)
                found[prop.name][1].append(self.take(self.order + prop.kind, length))
        return {
            name: (np.array(n, int), np.concatenate(v).astype(np.float64) if v else np.zeros(0))
            for name, (n, v) in found.items()
        }


def mesh_of(values: dict[str, Values]) -> MeshFile:
    vertex, face = values.get("vertex", {}), values.get("face", {})
    loops = face.get("vertex_indices", face.get("vertex_index"))
    if not {"x", "y", "z"} <= vertex.keys() or not isinstance(loops, tuple):
        raise ValueError("it has no vertices with x, y, z and faces with vertex_indices")
    total, loop = loops[0].astype(np.int64), loops[1].astype(np.int64)
    if len(total) and total.min() < 3:
        raise ValueError(f"face {int(total.argmin())} has fewer than three corners")
    count = len(vertex["x"])
    whole = len(loop) and 0 <= loop.min() and loop.max() < count
    colors = None
    if whole and {"red", "green", "blue"} <= vertex.keys():
        rgb = np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1)
        colors = np.clip(mean_of_corners(rgb / (255 if rgb.max(initial=0) > 1 else 1), total, loop), 0, 1)
    pairs = [pair for pair in (("s", "t"), ("u", "v"), ("texture_u", "texture_v")) if set(pair) <= vertex.keys()]
    uv = np.stack([vertex[name] for name in pairs[0]], axis=1) if pairs and whole else None
    return MeshFile(
        poses=np.stack([vertex[axis] for axis in "xyz"], axis=1)[None],
        loop_total=total,
        loop_vertices=loop,
        face_colors=colors,
        uv=uv,
        loop_uv=None if uv is None else loop,
    )
