"""glTF 2.0 (.glb, .gltf): triangles of the default scene with node transforms, morph targets, skins and animation.

Faces come in the file's order: nodes depth first, their primitives one after the other. glTF splits vertices at every
seam of normals, texture coordinates and materials; those of one mesh that coincide (and move alike) are joined again,
so that closed bodies are closed here too. The base colour of a face is its material's, times vertex colours or the
texture.

General mesh libraries visit children in another order, put a skinned mesh where its node is instead of where its bones
are, and pass over pictures that they cannot read; so the arrays are put together here.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.meshes.gltf_document import Document
from cloak_core.sources.bodies.meshes.mesh_file import MeshFile, to_linear, to_srgb

MAX_PRIMITIVES = 1 << 15
GREY = to_linear(np.full(3, 0.5))
"""Scene-linear colour of what has no material."""
Moved = dict[int, dict[str, np.ndarray]]
"""What an animation sets at one time: node -> translation, rotation, scale, weights."""


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
        poses = []
        for time in times:
            moved = {} if time is None else sample_animation(document, time)
            worlds = world_matrices(document, moved)
            poses.append(np.concatenate([part.posed(moved, worlds) for part in parts]))
        return mesh_of(document, parts, np.stack(poses))
    except InputError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError, struct.error) as error:
        raise InputError(f"{path}: not a readable glTF file ({type(error).__name__}: {error})") from None


def mesh_of(document: Document, parts: list[Part], poses: np.ndarray) -> MeshFile:
    """Join all parts into one mesh."""
    offsets = np.cumsum([0] + [len(part.positions) for part in parts])
    triangles = np.concatenate([part.triangles + offset for part, offset in zip(parts, offsets, strict=False)])
    uv, loop_uv = np.unique(np.concatenate([part.corner_uv for part in parts]), axis=0, return_inverse=True)
    return MeshFile(
        poses=poses,
        loop_total=np.full(len(triangles), 3, np.int64),
        loop_vertices=triangles.reshape(-1),
        face_colors=np.clip(np.concatenate([part.colors for part in parts]), 0, 1),
        uv=uv,
        loop_uv=np.where(np.concatenate([part.has_uv for part in parts]), loop_uv.reshape(-1), -1),
        pictures=document.base_pictures,
        picture_of=np.concatenate([part.picture_of for part in parts]),
    )


class Part:
    """One node's mesh: its primitives put together, and the vertices that coincide joined."""

    def __init__(self, document: Document, node: int) -> None:
        self.node = node
        record = document.list("nodes")[node]
        mesh = document.list("meshes")[record["mesh"]]
        self.rest_weights = np.array(record.get("weights", mesh.get("weights", [])), float)
        primitives = [read_primitive(document, primitive) for primitive in mesh["primitives"]]
        joined = {name: np.concatenate([arrays[name] for arrays in primitives]) for name in primitives[0]}
        columns = [joined[name].reshape(len(joined["positions"]), -1) for name in MOVING]
        _, first, inverse = np.unique(np.concatenate(columns, axis=1), axis=0, return_index=True, return_inverse=True)
        # Numbered by first appearance, not by the sorted rows' order.
        rank = np.argsort(np.argsort(first))
        self.positions, self.morphs, joints, self.weights = (joined[name][np.sort(first)] for name in MOVING)
        self.joints = joints.astype(np.int64)
        counts = [len(arrays["positions"]) for arrays in primitives]
        sizes = [len(arrays["triangles"]) for arrays in primitives]
        loose = joined["triangles"] + np.repeat(np.cumsum([0, *counts[:-1]]), sizes)[:, None]
        self.triangles = rank[inverse.reshape(-1)][loose]
        self.colors = to_srgb(joined["colors"])
        self.picture_of, self.corner_uv, self.has_uv = joined["picture_of"], joined["corner_uv"], joined["has_uv"]
        self.skin = None
        if "skin" in record and self.weights.shape[1]:
            skin = document.list("skins")[record["skin"]]
            matrices = np.eye(4)[None].repeat(len(skin["joints"]), 0)
            if (inverse_bind := skin.get("inverseBindMatrices")) is not None:
                matrices = document.accessor(inverse_bind).astype(float).transpose(0, 2, 1)
            self.skin = (skin["joints"], matrices)

    def posed(self, moved: Moved, worlds: dict[int, np.ndarray]) -> np.ndarray:
        """Pose this part: vertices [V, 3] in the scene's axes."""
        weights = np.asarray(moved.get(self.node, {}).get("weights", self.rest_weights), float)
        positions = self.positions.astype(float)
        if self.morphs.shape[1] and len(weights):
            positions = positions + np.einsum("vmk,m->vk", self.morphs[:, : len(weights)], weights)
        points = np.concatenate([positions, np.ones((len(positions), 1))], axis=1)
        if self.skin is None:
            return (points @ worlds[self.node].T)[:, :3]
        # A skinned mesh is where its bones are: the format says that its own node's transform does not count.
        joints, inverse_bind = self.skin
        bones = np.stack([worlds[joint] for joint in joints]) @ inverse_bind
        total = np.maximum(self.weights.sum(axis=1, keepdims=True), 1e-12)
        skinned = np.zeros_like(points)
        for column in range(self.weights.shape[1]):
            weight = (self.weights / total)[:, column, None]
            skinned += weight * np.einsum("vab,vb->va", bones[self.joints[:, column]], points)
        return skinned[:, :3]


MOVING = ("positions", "morphs", "joints", "weights")
"""Arrays of a primitive that say where a vertex goes."""


def read_primitive(document: Document, record: dict) -> dict[str, np.ndarray]:
    """Read the arrays of one primitive, triangles of one material: `MOVING` by vertex, others by triangle or corner.

    colors: scene-linear, [T, 3]; picture_of [T], -1 where there is none; corner_uv [3 T, 2], v up, and whether a corner
    has coordinates at all.
    """
    if record.get("mode", 4) != 4:
        raise InputError(f"{document.path}: only triangle lists are read, not primitive mode {record['mode']}")
    attributes = record["attributes"]

    def read(name: str) -> np.ndarray | None:
        return document.geometry(attributes[name]) if name in attributes else None

    positions = document.geometry(attributes["POSITION"]).astype(np.float64)
    count = len(positions)
    indices = document.geometry(record["indices"]) if "indices" in record else np.arange(count)
    if indices.size % 3 or (indices.size and int(indices.max()) >= count):
        raise ValueError("a primitive's indices do not fit its vertices")
    triangles = indices.astype(np.int64).reshape(-1, 3)
    targets = [document.geometry(t["POSITION"]) for t in record.get("targets", []) if "POSITION" in t]
    sets = [i for i in range(8) if f"JOINTS_{i}" in attributes and f"WEIGHTS_{i}" in attributes]
    joints, weights = (
        np.concatenate([read(f"{name}_{i}") for i in sets], axis=1) if sets else np.zeros((count, 0))
        for name in ("JOINTS", "WEIGHTS")
    )
    factor, texture = document.base_color(record.get("material"))
    uv = read(f"TEXCOORD_{(texture or {}).get('texCoord', 0)}")
    picture = -1
    if texture is not None:
        if uv is None:
            text = f"material {record['material']} has a texture, but its mesh no texture coordinates (UVs)"
            raise InputError(f"{document.path}: {text}")
        uv = transformed(uv, texture.get("extensions", {}).get("KHR_texture_transform", {}))
        picture = document.base_picture(texture["index"], tuple(factor.tolist()))
    colors = np.zeros(triangles.shape) + (GREY if record.get("material") is None else factor)
    if (painted := read("COLOR_0")) is not None:
        colors = factor * painted[triangles][..., :3].mean(axis=1)
    return {
        "positions": positions,
        "morphs": np.stack(targets, axis=1) if targets else np.zeros((count, 0, 3)),
        "joints": joints,
        "weights": weights,
        "triangles": triangles,
        "colors": colors,
        "picture_of": np.full(len(triangles), picture),
        # glTF counts v downwards.
        "corner_uv": np.zeros((triangles.size, 2)) if uv is None else uv[triangles.reshape(-1)] * [1.0, -1.0] + [0, 1],
        "has_uv": np.full(triangles.size, uv is not None),
    }


def transformed(uv: np.ndarray, transform: dict) -> np.ndarray:
    """Apply KHR_texture_transform to texture coordinates."""
    angle = float(transform.get("rotation", 0))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return uv * np.array(transform.get("scale", (1, 1))) @ turn.T + np.array(transform.get("offset", (0, 0)))


def world_matrices(document: Document, moved: Moved) -> dict[int, np.ndarray]:
    """Compute where each node is [4, 4]. Each chain of parents is walked once: a file may be one chain of all nodes."""
    nodes = document.list("nodes")
    parent = {child: index for index, node in enumerate(nodes) for child in node.get("children", [])}
    worlds: dict[int, np.ndarray] = {}
    for index in range(len(nodes)):
        chain = []
        at = index
        while at is not None and at not in worlds:
            if len(chain) > len(nodes):
                raise ValueError("its nodes are no tree")
            chain.append(at)
            at = parent.get(at)
        for node in reversed(chain):
            above = worlds[parent[node]] if node in parent else np.eye(4)
            worlds[node] = above @ local_matrix(nodes[node], moved.get(node, {}))
    return worlds


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


def sample_animation(document: Document, time: float) -> Moved:
    """Sample the first animation at `time` seconds."""
    animation = document.list("animations")[0]
    moved: Moved = {}
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
