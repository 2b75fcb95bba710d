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
Values = dict[str, np.ndarray | tuple[np.ndarray, np.ndarray]]
"""Property name -> values [count], or (lengths [count], all values) of a list."""


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
    """Read a PLY file's vertices and faces in their order. Raises `InputError` for what is damaged or no mesh.

    General mesh libraries read no binary file in which triangles and quads are mixed, and cut quads in two.
    """
    data = read_bytes(path, MAX_FILE_BYTES)
    try:
        order, elements, start = read_header(data)
        reader = Reader(data, start, order)
        return mesh_of({element.name: reader.element(element) for element in elements})
    except InputError:
        raise
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise InputError(f"{path}: not a readable PLY mesh ({error})") from None


def read_header(data: bytes) -> tuple[str, list[Element], int]:
    """Read the header: (byte order, elements, where the values begin)."""
    end = data.find(b"end_header")
    start = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or not start:
        raise ValueError("it has no PLY header")
    order = None
    elements = []
    # All numbers of an ASCII file become 64-bit floats.
    typed = lambda kind: order + TYPES[kind] if order else "f8"
    for line in data[:end].decode("ascii", "replace").splitlines():
        match line.split():
            case ["format", name, _] if not elements:
                order = ORDERS[name]
            case ["element", name, count]:
                elements.append(Element(name, int(count)))
            case ["property", "list", count_kind, kind, name]:
                elements[-1].properties.append(Property(name, typed(kind), typed(count_kind)))
            case ["property", kind, name]:
                elements[-1].properties.append(Property(name, typed(kind)))
    if order is None or any(not 0 <= element.count <= len(data) for element in elements):
        raise ValueError("its header promises more than the file holds")
    return order, elements, start


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

    def element(self, element: Element) -> Values:
        """Read an element's properties as 64-bit floats: a table at once, rows with lists one by one."""
        properties = element.properties
        if all(prop.count_kind is None for prop in properties):
            table = self.take(np.dtype([(prop.name, prop.kind) for prop in properties]), element.count)
            return {prop.name: table[prop.name].astype(np.float64) for prop in properties}
        columns: dict[str, list[np.ndarray]] = {prop.name: [] for prop in properties}
        for _ in range(element.count):
            for prop in properties:
                length = 1 if prop.count_kind is None else int(self.take(prop.count_kind, 1)[0])
                columns[prop.name].append(self.take(prop.kind, length))
        values: Values = {}
        for prop in properties:
            rows = columns[prop.name]
            numbers = np.concatenate([np.zeros(0), *rows])
            values[prop.name] = numbers if prop.count_kind is None else (np.array([*map(len, rows)], int), numbers)
        return values


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
        loop_uv=loop,
    )
