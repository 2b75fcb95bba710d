"""glTF 2.0 (.glb, .gltf): triangles of the default scene with node transforms, morph targets, skins and animation.

Faces come in the file's order: nodes depth first, their primitives one after the other. glTF splits vertices at every
seam of normals, texture coordinates and materials; those of one mesh that coincide (and move alike) are joined again,
so that closed bodies are closed here too. The base colour of a face is its material's, times vertex colours or the
texture.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.meshes.gltf_document import Document
from cloak_core.sources.bodies.meshes.mesh_file import MeshFile, to_linear, to_srgb
from cloak_core.sources.bodies.meshes.pictures import with_pictures

MAX_PRIMITIVES = 1 << 15
GREY = to_linear(np.full(3, 0.5))
"""Scene-linear colour of what has no material."""


def read_gltf(path: Path, frames: int = 0) -> MeshFile:
    """Read a glTF file: in its resting pose, or with `frames` > 0 in that many moments evenly over its first animation.

    Raises `InputError` for what is damaged, compressed geometry, strips and points, and frames without animation.
    """
    try:
        document = Document(path)
        times = document.frame_times(frames)
        nodes = document.mesh_nodes()
        meshes, of = document.list("meshes"), document.list("nodes")
        if sum(len(meshes[of[node]["mesh"]]["primitives"]) for node in nodes) > MAX_PRIMITIVES:
            raise InputError(f"{path}: more than {MAX_PRIMITIVES:,} primitives")
        parts = [Part(document, node) for node in nodes]
        poses = [
            np.concatenate([part.posed(moment) for part in parts])
            for moment in (Moment(document, time) for time in times)
        ]
        return mesh_of(document, parts, np.stack(poses))
    except InputError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError, struct.error) as error:
        raise InputError(f"{path}: not a readable glTF file ({type(error).__name__}: {error})") from None


class Moment:
    """Where all nodes are, and their morph weights, at one time (None: at rest)."""

    def __init__(self, document: Document, time: float | None) -> None:
        nodes = document.list("nodes")
        moved = {} if time is None else sample_animation(document, time)
        local = [local_matrix(node, moved.get(index, {})) for index, node in enumerate(nodes)]
        self.morphs = {index: values["weights"] for index, values in moved.items() if "weights" in values}
        parent = {child: index for index, node in enumerate(nodes) for child in node.get("children", [])}
        self.matrices: dict[int, np.ndarray] = {}
        for index in range(len(nodes)):
            chain = []
            at = index
            while at is not None and at not in self.matrices:
                if len(chain) > len(nodes):
                    raise ValueError("its nodes are no tree")
                chain.append(at)
                at = parent.get(at)
            for node in reversed(chain):
                above = self.matrices[parent[node]] if node in parent else np.eye(4)
                self.matrices[node] = above @ local[node]


def local_matrix(node: dict, moved: dict[str, np.ndarray]) -> np.ndarray:
    """Compute a node's transform [4, 4] against its parent, with what the animation sets of it."""
    if "matrix" in node and not moved.keys() & {"translation", "rotation", "scale"}:
        return np.array(node["matrix"], float).reshape(4, 4).T

    def value(name: str, default: tuple[float, ...]) -> np.ndarray:
        return np.asarray(moved.get(name, node.get(name, default)), float)

    turn = Rotation.from_quat(value("rotation", (0.0, 0.0, 0.0, 1.0))).as_matrix()
    matrix = np.eye(4)
    matrix[:3, :3] = turn * value("scale", (1.0, 1.0, 1.0))
    matrix[:3, 3] = value("translation", (0.0, 0.0, 0.0))
    return matrix


class Part:
    """One node's mesh: its primitives put together, and the vertices that coincide joined."""

    def __init__(self, document: Document, node: int) -> None:
        self.document = document
        self.node = node
        record = document.list("nodes")[node]
        mesh = document.list("meshes")[record["mesh"]]
        self.rest_weights = np.array(record.get("weights", mesh.get("weights", [])), float)
        primitives = [Primitive(document, primitive) for primitive in mesh["primitives"]]
        offsets = np.cumsum([0] + [len(p.positions) for p in primitives])

        def join(name: str) -> np.ndarray:
            return np.concatenate([getattr(p, name) for p in primitives])

        positions, morphs = join("positions"), join("morphs")
        joints, weights = join("joints"), join("weights")
        rows = np.concatenate([positions, morphs.reshape(len(positions), -1), joints, weights], axis=1)
        _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        # Numbered by first appearance, not by the sorted rows' order.
        rank = np.argsort(np.argsort(first))
        kept = np.sort(first)
        self.positions, self.morphs, self.joints, self.weights = (
            a[kept] for a in (positions, morphs, joints.astype(np.int64), weights)
        )
        triangles = [p.triangles + offset for p, offset in zip(primitives, offsets, strict=False)]
        loose = np.concatenate(triangles)
        self.triangles = rank[inverse.reshape(-1)][loose]
        self.colors = to_srgb(join("colors"))
        self.picture_of = np.concatenate([np.full(len(p.triangles), p.picture) for p in primitives])
        self.has_uv = all(p.uv is not None for p in primitives)
        self.corner_uv = np.concatenate([p.corner_uv() for p in primitives])
        self.skin = None
        if "skin" in record and self.weights.shape[1]:
            skin = document.list("skins")[record["skin"]]
            inverse_bind = skin.get("inverseBindMatrices")
            matrices = np.eye(4)[None].repeat(len(skin["joints"]), 0)
            if inverse_bind is not None:
                matrices = document.accessor(inverse_bind).astype(float).transpose(0, 2, 1)
            self.skin = (skin["joints"], matrices)

    def posed(self, moment: Moment) -> np.ndarray:
        """Pose this part: vertices [V, 3] in the scene's axes."""
        weights = np.asarray(moment.morphs.get(self.node, self.rest_weights), float)
        positions = self.positions.astype(float)
        if self.morphs.shape[1] and len(weights):
            positions = positions + np.einsum("vmk,m->vk", self.morphs[:, : len(weights)], weights)
        points = np.concatenate([positions, np.ones((len(positions), 1))], axis=1)
        if self.skin is None:
            return (points @ moment.matrices[self.node].T)[:, :3]
        joints, inverse_bind = self.skin
        bones = np.stack([moment.matrices[joint] for joint in joints]) @ inverse_bind
        total = np.maximum(self.weights.sum(axis=1, keepdims=True), 1e-12)
        skinned = np.zeros_like(points)
        for column in range(self.weights.shape[1]):
            weight = (self.weights / total)[:, column, None]
            skinned += weight * np.einsum("vab,vb->va", bones[self.joints[:, column]], points)
        return skinned[:, :3]


class Primitive:
    """Arrays of one primitive: triangles of one material."""

    def __init__(self, document: Document, record: dict) -> None:
        if record.get("mode", 4) != 4:
            raise InputError(f"{document.path}: only triangle lists are read, not primitive mode {record['mode']}")
        self.document = document
        self.attributes = record["attributes"]
        self.positions = document.geometry(self.attributes["POSITION"]).astype(np.float64)
        count = len(self.positions)
        indices = document.geometry(record["indices"]) if "indices" in record else np.arange(count)
        if indices.size % 3 or (indices.size and int(indices.max()) >= count):
            raise ValueError("a primitive's indices do not fit its vertices")
        self.triangles = indices.astype(np.int64).reshape(-1, 3)
        targets = [document.geometry(t["POSITION"]) for t in record.get("targets", []) if "POSITION" in t]
        self.morphs = np.stack(targets, axis=1) if targets else np.zeros((count, 0, 3))
        sets = [i for i in range(8) if f"JOINTS_{i}" in self.attributes and f"WEIGHTS_{i}" in self.attributes]
        self.joints = self.weights = np.zeros((count, 0))
        if sets:
            self.joints = np.concatenate([self.read(f"JOINTS_{i}") for i in sets], axis=1)
            self.weights = np.concatenate([self.read(f"WEIGHTS_{i}") for i in sets], axis=1)
        self.look(record.get("material"))

    def read(self, name: str) -> np.ndarray | None:
        """Read an attribute's values for each vertex; None where there are none."""
        return self.document.geometry(self.attributes[name]) if name in self.attributes else None

    def look(self, index: int | None) -> None:
        """Set colours (scene-linear, [T, 3]), texture coordinates and picture as a material has them."""
        materials = self.document.list("materials")
        material = {} if index is None else materials[index].get("pbrMetallicRoughness", {})
        factor = np.array(material.get("baseColorFactor", (1, 1, 1, 1)), float)[:3]
        texture = material.get("baseColorTexture")
        vertex_colors = self.read("COLOR_0")
        self.uv = self.read(f"TEXCOORD_{(texture or {}).get('texCoord', 0)}")
        self.picture = -1
        if texture is not None:
            if self.uv is None:
                raise InputError(
                    f"{self.document.path}: material {index} has a texture, but its mesh no texture coordinates (UVs)"
                )
            self.uv = transformed(self.uv, texture.get("extensions", {}).get("KHR_texture_transform", {}))
            self.picture = self.document.base_picture(texture["index"], tuple(factor.tolist()))
        if vertex_colors is not None:
            self.colors = factor * vertex_colors[self.triangles][..., :3].mean(axis=1)
        else:
            self.colors = np.zeros(self.triangles.shape) + (GREY if index is None else factor)

    def corner_uv(self) -> np.ndarray:
        """Give texture coordinates of the triangles' corners [3 T, 2], v up (glTF counts it downwards)."""
        if self.uv is None:
            return np.zeros((self.triangles.size, 2))
        return self.uv[self.triangles.reshape(-1)].astype(float) * [1, -1] + [0, 1]


def transformed(uv: np.ndarray, transform: dict) -> np.ndarray:
    """Apply KHR_texture_transform to texture coordinates."""
    angle = float(transform.get("rotation", 0))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return uv * np.array(transform.get("scale", (1, 1))) @ turn.T + np.array(transform.get("offset", (0, 0)))


def mesh_of(document: Document, parts: list[Part], poses: np.ndarray) -> MeshFile:
    """Join all parts into one mesh."""
    offsets = np.cumsum([0] + [len(part.positions) for part in parts])
    triangles = np.concatenate([part.triangles + offset for part, offset in zip(parts, offsets, strict=False)])
    loop_total = np.full(len(triangles), 3, np.int64)
    colors = np.clip(np.concatenate([part.colors for part in parts]), 0, 1)
    picture_of = np.concatenate([part.picture_of for part in parts])
    corner_uv = np.concatenate([part.corner_uv for part in parts])
    uv = loop_uv = None
    if all(part.has_uv for part in parts):
        uv, loop_uv = np.unique(corner_uv, axis=0, return_inverse=True)
    mesh = MeshFile(
        poses=poses,
        loop_total=loop_total,
        loop_vertices=triangles.reshape(-1),
        face_colors=colors,
        uv=uv,
        loop_uv=None if loop_uv is None else loop_uv.reshape(-1),
    )
    return with_pictures(document.path, mesh, document.base_pictures, picture_of, corner_uv)


def sample_animation(document: Document, time: float) -> dict[int, dict[str, np.ndarray]]:
    """Sample the first animation at `time` seconds: what it sets of each node.

    Node -> translation, rotation, scale, weights.
    """
    animation = document.list("animations")[0]
    moved: dict[int, dict[str, np.ndarray]] = {}
    for channel in animation["channels"]:
        target = channel["target"]
        sampler = animation["samplers"][channel["sampler"]]
        if "node" not in target:
            continue
        times = document.accessor(sampler["input"]).astype(float)
        values = document.accessor(sampler["output"]).astype(float)
        kind = sampler.get("interpolation", "LINEAR")
        values = values.reshape(len(times), 3 if kind == "CUBICSPLINE" else 1, -1)
        moved.setdefault(target["node"], {})[target["path"]] = interpolate(
            times, values, time, kind, spherical=target["path"] == "rotation"
        )
    return moved


def interpolate(times: np.ndarray, values: np.ndarray, time: float, kind: str, spherical: bool) -> np.ndarray:
    """Interpolate one channel; values [keys, 1 or 3, n] (cubic splines store in-tangent, value, out-tangent)."""
    middle = values.shape[1] // 2
    key = int(np.searchsorted(times, time, side="right")) - 1
    if key < 0 or key >= len(times) - 1:
        return values[max(key, 0), middle]
    span = times[key + 1] - times[key]
    t = (time - times[key]) / span
    a, b = values[key, middle], values[key + 1, middle]
    if kind == "STEP":
        return a
    if kind == "CUBICSPLINE":
        leave, arrive = span * values[key, 2], span * values[key + 1, 0]
        t2, t3 = t * t, t * t * t
        return (2 * t3 - 3 * t2 + 1) * a + (t3 - 2 * t2 + t) * leave + (3 * t2 - 2 * t3) * b + (t3 - t2) * arrive
    return Slerp([0, 1], Rotation.from_quat([a, b]))(t).as_quat() if spherical else a + t * (b - a)
