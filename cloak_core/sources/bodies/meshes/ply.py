"""Stanford PLY, ASCII and binary: vertices, polygons as they are, vertex colours and texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_bytes
from cloak_core.sources.bodies.meshes.mesh_file import MAX_FILE_BYTES, MeshFile, mean_of_corners

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
        reader = Reader(data, start, order)
        values = {element.name: reader.element(element) for element in elements}
        return mesh_of(values)
    except InputError:
        raise
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise InputError(f"{path}: not a readable PLY mesh ({error})") from None


def typed(order: str | None, kind: str) -> str:
    """Name a type as numpy does; all numbers of an ASCII file become 64-bit floats."""
    return order + TYPES[kind] if order else "f8"


def read_header(data: bytes) -> tuple[str, list[Element], int]:
    """Read the header: (byte order, elements, where the values begin)."""
    end = data.find(b"end_header")
    start = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or not start:
        raise ValueError("it has no PLY header")
    order, elements = None, []
    for line in data[:end].decode("ascii", "replace").splitlines():
        match line.split():
            case ["format", name, _] if not elements:
                order = ORDERS[name]
            case ["element", name, count]:
                elements.append(Element(name, int(count)))
            case ["property", "list", count_kind, kind, name]:
                elements[-1].properties.append(Property(name, typed(order, kind), typed(order, count_kind)))
            case ["property", kind, name]:
                elements[-1].properties.append(Property(name, typed(order, kind)))
    if order is None or any(not 0 <= element.count <= len(data) for element in elements):
        raise ValueError("its header promises more than the file holds")
    return order, elements, start


Values = dict[str, np.ndarray | tuple[np.ndarray, np.ndarray]]


class Reader:
    """Takes the values of one element after the other; those of an ASCII file as if they were 64-bit floats."""

    def __init__(self, data: bytes, start: int, order: str) -> None:
        self.data, self.at = data, start
        if not order:
            self.data, self.at = np.fromiter(map(float, data[start:].split()), np.float64).tobytes(), 0

    def take(self, kind: str | np.dtype, count: int) -> np.ndarray:
        dtype = np.dtype(kind)
        if count < 0 or self.at + count * dtype.itemsize > len(self.data):
            raise ValueError("it is truncated")
        values = np.frombuffer(self.data, dtype, count, self.at)
        self.at += count * dtype.itemsize
        return values

    def take_list(self, prop: Property) -> np.ndarray:
        """Take a list's values in one row, or the one value that is no list."""
        length = 1 if prop.count_kind is None else int(self.take(prop.count_kind, 1)[0])
        return self.take(prop.kind, length)

    def element(self, element: Element) -> Values:
        """Read an element: property name -> values [count], or (lengths [count], all values) of a list."""
        values = self.even_rows(element)
        if values is None:
            rows = [[self.take_list(prop) for prop in element.properties] for _ in range(element.count)]
            columns = zip(element.properties, zip(*rows, strict=True), strict=True)
            values = {prop.name: (np.array([*map(len, lists)]), np.concatenate(lists)) for prop, lists in columns}
        found = {}
        for prop in element.properties:
            length, numbers = values[prop.name][0], values[prop.name][1].astype(np.float64)
            found[prop.name] = numbers if prop.count_kind is None else (length, numbers)
        return found

    def even_rows(self, element: Element) -> dict[str, tuple[np.ndarray, np.ndarray]] | None:
        """Read all rows at once, where every list is as long as the first row's; else None, and nothing is taken."""
        start, fields, lengths = self.at, [], {}
        for prop in element.properties:
            lengths[prop.name] = len(self.take_list(prop)) if element.count else 1
            if prop.count_kind is not None:
                fields.append((f"{prop.name} length", prop.count_kind))
            fields.append((prop.name, prop.kind, (lengths[prop.name],)))
        self.at, dtype = start, np.dtype(fields)
        lists = [prop.name for prop in element.properties if prop.count_kind is not None]
        if lists and start + element.count * dtype.itemsize > len(self.data):
            return None
        table = self.take(dtype, element.count)
        if any((table[f"{name} length"] != lengths[name]).any() for name in lists):
            self.at = start
            return None
        return {name: (np.full(element.count, n), table[name].reshape(-1)) for name, n in lengths.items()}


def mesh_of(values: dict[str, Values]) -> MeshFile:
    vertex, face = values.get("vertex", {}), values.get("face", {})
    loops = face.get("vertex_indices", face.get("vertex_index"))
    if not {"x", "y", "z"} <= vertex.keys() or not isinstance(loops, tuple):
        raise ValueError("it has no vertices with x, y, z and faces with vertex_indices")
    total, loop = (values.astype(np.int64) for values in loops)
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
