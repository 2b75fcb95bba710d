"""People in cloth: T-shirts and trousers that hang, swing and fold, over bodies that walk, run, wave or stand.

`tools/pretrain/bake_clothed.py` made them with Blender's cloth solver; `data/README.md` tells from what. Stored
are each person at rest, the bones of every frame, and how far the cloth is from the skin that it was cut from. Every
number follows from these by additions and multiplications in a fixed order, so that a pose has the same bits on every
machine.
"""

from __future__ import annotations

from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64

from cloak_core.core.polygons import triangulate
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_npz
from cloak_core.sources.bodies.people.samples import HEADWEAR
from cloak_core.sources.bodies.people.samples import load as load_samples

DATA = Path(__file__).parents[1] / "data" / "clothed.npz"
OBJECTS = ("body", "shirt", "trousers")
"""Of the scene, in the order in which faces and vertices are numbered through."""
LIES_ON = {
    "shirt": ("chest", "belly", "back", "arms"),
    "trousers": ("thighs", "shins"),
    "body": ("head", *HEADWEAR, "hands", "feet", "forearms"),
}
"""Regions of the sample bodies, by the object that has them here."""
TIGHT = {"shirt": 0.008, "trousers": 0.004}
"""Metres from the skin of garments that fit tightly."""
SCENES = ("sample-clothed", "sample-tight")


def clothed_bodies(split: str = "all", tight: bool = False) -> Bodies:
    """Load the clothed people: looped cycles "train", other people, motions and folds "unseen", or "all".

    One topology: the skin that is not hidden, then the shirt, then the trousers, which are also regions; so are chest,
    belly, back, arms (sleeves), thighs and shins on the garments, and head, headwear, hands, feet and forearms.
    A pose is called MOTION-PERSON-wFOLDS-FRAME: people p1 to p5 are trained on, u1 to u3 unseen; frames of a name make
    a cycle.
    `tight`: the same people, motions and faces with the garments tight on the skin, as paint would be.
    """
    name = SCENES[tight]
    if split not in ("all", "train", "unseen"):
        raise InputError(f"scene '{name}:{split}': the clothed people come as {name}, {name}:train and {name}:unseen")
    return _clothed(split, tight)


tight_bodies = partial(clothed_bodies, tight=True)


@lru_cache(maxsize=4)
def _clothed(split: str, tight: bool) -> Bodies:
    data, (samples, _) = read_npz(DATA), load_samples()
    quads = data["quads"].astype(np.int32)
    owner = data["owner"]
    source = data["source_face"].astype(np.int64)
    chosen = [c for c, unseen in enumerate(data["clip_unseen"]) if split in ("all", ("train", "unseen")[int(unseen)])]
    loop_total = np.full(len(quads), 4, np.int32)
    regions = {name: owner == number for number, name in enumerate(OBJECTS)}
    regions |= {name: samples.regions[name][source] & regions[on] for on, names in LIES_ON.items() for name in names}
    # As the first pose of all has it, whichever poses are asked for.
    corners, triangle_face = triangulate(_poses(data, 0, tight=True)[0], loop_total, quads.reshape(-1))
    return Bodies(
        vertices=np.concatenate([_poses(data, clip, tight) for clip in chosen]).astype(np.float32),
        triangles=quads.reshape(-1)[corners],
        triangle_face=triangle_face,
        face_colors=_outfits(samples, owner, source),
        regions=regions | {"front": samples.regions["front"][source]},
        names=tuple(f"{data['clip_names'][c]}-{frame:02}" for c in chosen for frame in range(data["clip_frames"][c])),
        loop_total=loop_total,
        loop_vertices=quads.reshape(-1),
        name=SCENES[tight],
    )


def _poses(data: dict[str, np.ndarray], clip: int, tight: bool) -> Float64[np.ndarray, "frames V 3"]:
    """Compute the positions of all vertices through one cycle, metres."""
    skin = skin_of(data, clip)
    cut_from = skin[:, data["cut_from"]]
    bare = int(data["skin_vertices"])
    if tight:
        away = tight_offsets(data, cut_from)
    else:
        first = int(data["clip_frames"][:clip].sum())
        frames = slice(first, first + int(data["clip_frames"][clip]))
        # Stored are differences along the vertices, then along the frames, modulo 2^16.
        steps = np.cumsum(np.cumsum(data["cloth"][frames], axis=0, dtype=np.int16), axis=1, dtype=np.int16)
        away = steps * float(data["cloth_step"])
    return np.concatenate([skin[:, :bare], cut_from + away], axis=1)


def skin_of(data: dict[str, np.ndarray], clip: int) -> Float64[np.ndarray, "frames R 3"]:
    """Skin all stored skin vertices (linear blend), hidden ones too: those that stay seen come first."""
    person = int(data["clip_person"][clip])
    steps = np.cumsum(data["rest_steps"][person], axis=0, dtype=np.uint16)
    rest = data["rest_origin"][person] + steps * data["rest_step"][person].astype(np.float64)
    first = int(data["clip_frames"][:clip].sum())
    bones = data["bones"][first : first + int(data["clip_frames"][clip])].astype(np.float64)
    skin = np.zeros((len(bones), len(rest), 3))
    ends = np.cumsum(data["weight_count"])
    for bone, (start, end) in enumerate(zip(ends - data["weight_count"], ends, strict=True)):
        rows = data["weight_vertex"][start:end]
        weight = data["weight"][start:end] / 65535
        point = rest[rows]
        for axis in range(3):
            a, b, c, offset = (bones[:, bone, axis, k, None] for k in range(4))
            skin[:, rows, axis] += weight * (a * point[:, 0] + b * point[:, 1] + c * point[:, 2] + offset)
    return skin


def tight_offsets(
    data: dict[str, np.ndarray], cut_from: Float64[np.ndarray, "frames G 3"]
) -> Float[np.ndarray, "f G 3"]:
    """Move from the skin along the garments' own normals, by `TIGHT`."""
    bare = int(data["skin_vertices"])
    owner = data["owner"]
    quads = data["quads"].astype(np.int64)[owner > 0] - bare
    thickness = np.zeros(cut_from.shape[1])
    for number, name in enumerate(OBJECTS[1:], 1):
        thickness[data["quads"][owner == number].astype(np.int64) - bare] = TIGHT[name]
    corners = cut_from[:, quads]
    face = np.cross(corners[:, :, 2] - corners[:, :, 0], corners[:, :, 3] - corners[:, :, 1])
    normal = np.zeros_like(cut_from)
    for corner in range(4):
        np.add.at(normal, (slice(None), quads[:, corner]), face)
    length = np.sqrt(normal[..., 0] ** 2 + normal[..., 1] ** 2 + normal[..., 2] ** 2)
    return normal / np.maximum(length, 1e-12)[..., None] * thickness[:, None]


def _outfits(samples: Bodies, owner: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Take the samples' outfits [K, F, 3]: arms and ankles that look out of the garments are bare."""
    first = {name: int(np.flatnonzero(mask)[0]) for name, mask in samples.regions.items()}
    worn = source.copy()
    worn[owner == 1], worn[owner == 2] = first["chest"], first["thighs"]
    clothing = samples.regions["shirt"] | samples.regions["trousers"]
    worn[(owner == 0) & clothing[source]] = first["hands"]
    return samples.face_colors[:, worn]
