"""Wavefront OBJ: vertices, polygons, texture coordinates, plain colours and textures, in the file's own order.

General mesh libraries reorder the faces of files with several materials or with triangles among quads, and face ids are
what a face list consists of; so the lines are read here.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cloak_core.core.pictures import read_picture
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_text
from cloak_core.sources.bodies.meshes.mesh_file import MAX_FILE_BYTES, MeshFile, file_beside, mean_of_corners, to_srgb

GREY = (0.5, 0.5, 0.5)
MAX_MTL_BYTES = 4 << 20
MAP_OPTIONS = {"-blendu": 1, "-blendv": 1, "-boost": 1, "-clamp": 1, "-imfchan": 1, "-texres": 1, "-bm": 1,
               "-mm": 2, "-o": 3, "-s": 3, "-t": 3}  # fmt: skip
"""Words that may stand before a picture's file name, and how many values each takes."""


@dataclass
class Material:
    """Its diffuse colour, sRGB in [0, 1], and the picture that replaces it."""

    color: tuple[float, float, float] = GREY
    picture: str = ""


@dataclass
class ObjLines:
    """What the lines of one file say."""

    path: Path
    vertices: list[list[float]] = field(default_factory=list)
    colored: bool = False
    uv: list[list[float]] = field(default_factory=list)
    loop_total: list[int] = field(default_factory=list)
    loop: list[int] = field(default_factory=list)
    loop_uv: list[int] = field(default_factory=list)
    materials: dict[str, Material] = field(default_factory=dict)
    face_material: list[str] = field(default_factory=list)
    material: str = ""

    def read(self, kind: str, words: list[str]) -> None:
        """Take over a line. ValueError: it says too little, or no numbers."""
        if kind == "v":
            if len(words) < 3:
                raise ValueError("a vertex has three coordinates")
            # Six numbers are a position and a colour, as Blender and MeshLab write them; four a homogeneous position.
            numbers = [float(word) for word in words]
            self.colored |= len(numbers) >= 6
            self.vertices.append(numbers[:3] + (numbers[3:6] if len(numbers) >= 6 else []))
        elif kind == "vt":
            self.uv.append([*(float(word) for word in words[:2]), 0.0][:2])
        elif kind == "f":
            if len(words) < 3:
                raise ValueError("a face has three corners or more")
            for word in words:
                vertex, _, rest = word.partition("/")
                self.loop.append(resolve(vertex, len(self.vertices)))
                uv = rest.partition("/")[0]
                self.loop_uv.append(resolve(uv, len(self.uv)) if uv else -1)
            self.loop_total.append(len(words))
            self.face_material.append(self.material)
        elif kind == "usemtl":
            self.material = " ".join(words)
        elif kind == "mtllib":
            self.materials |= read_mtl(self.path, " ".join(words))

    def mesh(self) -> MeshFile:
        """Put the lines together."""
        numbers = np.array([(row + list(GREY))[:6] for row in self.vertices]).reshape(-1, 6)
        loop_total = np.array(self.loop_total, np.int64)
        loop = np.array(self.loop, np.int64)
        loop_uv = np.array(self.loop_uv, np.int64)
        colors, pictures, picture_of = None, [], None
        if self.colored and len(loop) and loop.max() < len(numbers):
            colors = mean_of_corners(numbers[:, 3:], loop_total, loop)
        elif self.materials:
            colors = np.array([self.materials.get(name, Material()).color for name in self.face_material])
        if colors is not None:
            colors = np.clip(np.nan_to_num(colors, nan=0.5), 0, 1)
            pictures, picture_of = ([], None) if self.colored else self.read_pictures()
        return MeshFile(
            poses=numbers[None, :, :3],
            loop_total=loop_total,
            loop_vertices=loop,
            face_colors=colors,
            uv=np.array(self.uv).reshape(-1, 2) if self.uv else None,
            loop_uv=np.where(loop_uv < len(self.uv), loop_uv, -1),
            pictures=pictures,
            picture_of=picture_of,
        )

    def read_pictures(self) -> tuple[list[np.ndarray], np.ndarray]:
        """Read the pictures of the materials in use, and tell which face has which."""
        pictures: dict[str, np.ndarray] = {}
        for name in dict.fromkeys(self.face_material):
            file = self.materials[name].picture if name in self.materials else ""
            beside = file_beside(self.path, file) if file else None
            if beside is not None:
                pictures[name] = read_picture(beside)
            elif file:
                text = f"{self.path}: its picture '{file}' is not in its folder: plain colour instead"
                warnings.warn(text, stacklevel=2)
        number = {name: index for index, name in enumerate(pictures)}
        return list(pictures.values()), np.array([number.get(name, -1) for name in self.face_material])


def resolve(word: str, count: int) -> int:
    """Count an index from 0; the file counts from 1, or backwards from the latest."""
    index = int(word)
    if index == 0 or not -count <= index < 1 << 31:
        raise ValueError(f"index {index} with {count} before it")
    return index - 1 if index > 0 else count + index


def read_obj(path: Path) -> MeshFile:
    """Read an OBJ file; all its objects and groups make one mesh, in the file's order.

    Colours come from vertex colours where there are any, else from the materials in .mtl files that lie in the same
    folder (others are ignored): the picture `map_Kd` where there is one, else `Kd`. Raises `InputError` with the line
    for what cannot be read; a picture that is not in the folder or below is a warning.
    """
    lines = ObjLines(path)
    text = read_text(path, MAX_FILE_BYTES, errors="replace")
    joined = text.replace("\\\r\n", " ").replace("\\\n", " ")
    for number, line in enumerate(joined.split("\n"), start=1):
        kind, *words = line.partition("#")[0].split() or [""]
        try:
            lines.read(kind, words)
        except InputError:
            raise
        except (ValueError, OverflowError) as error:
            raise InputError(f"{path}: line {number}: {error}") from None
    return lines.mesh()


def read_mtl(obj: Path, name: str) -> dict[str, Material]:
    """Read materials by name, from a file that lies in the OBJ's own folder or below; else none."""
    path = file_beside(obj, name)
    if path is None:
        return {}
    materials: dict[str, Material] = {}
    material = Material()
    for line in read_text(path, MAX_MTL_BYTES, errors="replace").splitlines():
        words = line.split()
        if words[:1] == ["newmtl"]:
            material = materials[" ".join(words[1:])] = Material()
        elif words[:1] == ["Kd"] and len(words) >= 4:
            try:
                # Blender writes its linear base colour here.
                material.color = tuple(to_srgb(np.array([float(word) for word in words[1:4]])))
            except ValueError:
                continue  # `Kd spectral ...`: a colour we do not know
        elif words[:1] == ["map_Kd"]:
            words = words[1:]
            while words and words[0] in MAP_OPTIONS:
                words = words[1 + MAP_OPTIONS[words[0]] :]
            material.picture = " ".join(words)
    return materials
