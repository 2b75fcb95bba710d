"""Bodies drawn from Anny, a free model of human shape: the very mesh of the sample bodies, in new shapes and poses.

Anny's code is Apache-2.0, the mesh and shapes behind it are MakeHuman's, CC0. Its first use builds a cache (minutes,
0.8 GB); everything works offline. The sample bodies were made by the same code
(`tools/pretrain/bake_bodies.py`), so their polygons, regions and outfits are the same, and a logo made for them fits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from cloak_core.core.geometry import connected_parts
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import read_scene
from cloak_core.files.errors import InputError
from cloak_core.files.reading import MAX_BYTES, read_npy, read_npz
from cloak_core.files.specs import split_spec
from cloak_core.sources.bodies.people.motions import MOTIONS
from cloak_core.sources.bodies.people.samples import load
from cloak_core.sources.bodies.people.skeleton import Skeleton, pose_vertices

# Anny is z up and faces -y; Cloak is y up and faces +z. A body's left stays at +x.
TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
POSES = {
    "natural": ("standing", "walking", "running", "waving"),
    "stand": ("standing",),
    "walk": ("walking",),
    "run": ("running",),
    "wave": ("waving",),
}
"""Which motions each word stands for, taken in turn."""
SHAPES = {
    "gender": (0.0, 1.0),
    "age": (0.62, 0.95),
    "muscle": (0.3, 0.9),
    "weight": (0.3, 0.85),
    "height": (0.2, 0.54),
    "proportions": (0.4, 0.7),
    "cupsize": (0.3, 0.6),
    "african": (0.0, 1.0),
    "asian": (0.0, 1.0),
    "caucasian": (0.0, 1.0),
}
"""Ranges of adult phenotypes that shapes are drawn from: those of the sample bodies."""
SPLITS = ("tongue", "mouth_cavity", "eye_front.L", "eye_front.R", "eye_back.L", "eye_back.R")


def anny_bodies(count: int, seed: int = 0, poses: str | Path = "natural", name: str = "anny") -> Bodies:
    """`count` people of random adult shapes, each in a pose of its own: poses drawn from a motion of `POSES`, or those
    of a file in turn (`read_anny_poses`).

    The same seed gives the same bodies, and body i does not depend on `count`. Raises `InputError` where the package
    is missing or another version than the sample bodies' gives another mesh.
    """
    samples, _ = load()
    if count < 1 or count * samples.vertex_count * 12 > MAX_BYTES:
        raise InputError(f"count {count}: between 1 and {MAX_BYTES // (samples.vertex_count * 12)} bodies are possible")
    read_poses = None if str(poses) in POSES else read_anny_poses(Path(poses))
    source = AnnySource()
    if not np.array_equal(source.quads.reshape(-1), samples.loop_vertices):
        raise InputError("anny: this version's mesh is not that of the sample bodies (0.6.2 is)")
    vertices = np.empty((count, samples.vertex_count, 3), np.float32)
    names = []
    for index in range(count):
        random = np.random.default_rng([seed, index])
        shape = {key: float(random.uniform(*limits)) for key, limits in SHAPES.items()}
        if read_poses is not None:
            posed = source.posed(shape, read_poses[index % len(read_poses)])
            motion = Path(poses).stem
        else:
            motion = POSES[str(poses)][index % len(POSES[str(poses)])]
            rest, skeleton = source.figure(shape)
            posed = pose_vertices(rest, source.weights, skeleton, MOTIONS[motion](random))
        vertices[index] = stand(posed)
        names.append(f"{motion}-{index:04}")
    return replace(samples, vertices=vertices, names=tuple(names), name=name, recorded_topology=samples.topology)


def drawn_bodies(asked: str = "") -> Bodies:
    """Draw bodies as COUNT[:SEED[:POSES]] asks. InputError: it asks for something else."""
    if not asked and Path("anny").exists():
        return read_scene("anny")  # a scene that is called so
    count, seed, poses = [*split_spec(asked), "", "", ""][:3]
    if not count.isdigit() or not (seed or "0").isdigit():
        raise InputError(f"scene 'anny:{asked}': bodies are drawn by anny:COUNT[:SEED[:POSES]], such as anny:64:0:walk")
    return anny_bodies(int(count), int(seed or 0), poses or "natural")


def read_anny_poses(path: Path) -> Float[np.ndarray, "poses bones 4 4"]:
    """Read poses in Anny's own terms (bones' turns, "local-bone"): .npy, or .npz: `pose_parameters` [P, 104, 4, 4]."""
    if not path.is_file():
        raise InputError(f"--poses {path}: neither a file nor one of {', '.join(POSES)}")
    if path.suffix.lower() == ".npz":
        poses = read_npz(path).get("pose_parameters")
        if poses is None:
            raise InputError(f"{path}: no array 'pose_parameters' in it")
    elif path.suffix.lower() == ".npy":
        poses = read_npy(path)
    else:
        raise InputError(f"{path}: poses for Anny are read from .npy and .npz")
    if poses.ndim != 4 or poses.shape[2:] != (4, 4) or not len(poses) or poses.dtype.kind != "f":
        raise InputError(
            f"{path}: {poses.dtype} of shape {poses.shape}, but numbers of shape (poses, bones, 4, 4) are needed"
        )
    if not np.isfinite(poses).all():
        bad = int(np.flatnonzero(~np.isfinite(poses).all(axis=(1, 2, 3)))[0])
        raise InputError(f"{path}: pose {bad} is not finite")
    return poses.astype(np.float64)


def stand(vertices: Float[np.ndarray, "vertices 3"]) -> Float[np.ndarray, "vertices 3"]:
    """Move the body so that its lowest point is at y = 0 and its middle at x = z = 0."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return vertices - [(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2]


class AnnySource:
    """Anny's rig and mesh without the tongue: what is left, skin and eyeballs, is closed and consistently oriented."""

    def __init__(self) -> None:
        try:
            import anny
            from anny.face_segmentation import get_face_segmentation_mask
        except ImportError:
            raise InputError("anny: needs the package anny: pip install 'cloak-core[anny]'") from None
        import torch

        self._torch = torch
        self.model = anny.Anny(rig="anny", topology="anny-quads", phenotypes="all", skinning_method="lbs")
        faces = self.model.faces.numpy()
        segments = {name: get_face_segmentation_mask(self.model, [name]).numpy() for name in SPLITS}
        component = connected_parts(faces, len(self.model.template_vertices))
        tongue = np.unique(component[faces[segments["tongue"]]])
        keep_face = ~np.isin(component[faces[:, 0]], tongue)
        self.kept = np.unique(faces[keep_face])
        renumber = np.full(len(component), -1)
        renumber[self.kept] = np.arange(len(self.kept))
        self.quads = renumber[faces[keep_face]]
        self.segments = {name: mask[keep_face] for name, mask in segments.items()}
        self.weights = self.model.dense_vertex_bone_weights.numpy()[self.kept]
        self.bone_names = list(self.model.bone_labels)
        self.bone_parents = [-1 if p is None else int(p) for p in self.model.bone_parents]

    def figure(self, shape: Mapping[str, float]) -> tuple[Float[np.ndarray, "vertices 3"], Skeleton]:
        """Make one adult at rest, in metres, y up: vertices and skeleton. `shape`: Anny's phenotypes, 0 to 1."""
        with self._torch.no_grad():
            rest = self.model(phenotype_kwargs=dict(shape))
        vertices = rest["rest_vertices"][0].double().numpy()[self.kept] @ TO_Y_UP.T
        joints = rest["rest_bone_heads"][0].double().numpy() @ TO_Y_UP.T
        return vertices, Skeleton(self.bone_names, self.bone_parents, joints)

    def posed(self, shape: Mapping[str, float], pose: Float[np.ndarray, "bones 4 4"]) -> Float[np.ndarray, "v 3"]:
        """Make one adult in a pose given in Anny's own terms."""
        if len(pose) != len(self.bone_names):
            raise InputError(f"poses of {len(pose)} bones, but Anny has {len(self.bone_names)}")
        parameters = self._torch.from_numpy(pose)[None].to(self.model.template_vertices.dtype)
        with self._torch.no_grad():
            done = self.model(pose_parameters=parameters, phenotype_kwargs=dict(shape))
        return done["vertices"][0].double().numpy()[self.kept] @ TO_Y_UP.T
