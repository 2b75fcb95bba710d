"""One clip: a body through a gait cycle, garments draped over it in Blender, and the cycle closed."""

from __future__ import annotations

import os
import subprocess
import tempfile
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from cloak_core.core.cameras import Number
from cloak_core.files.reading import read_npz
from cloak_core.files.writing import write_npz
from cloak_core.sources.bodies.blender.outside import blender_command
from cloak_core.sources.bodies.people.skeleton import Arm, Leg, Pose, Skeleton, bone_transforms
from tools.pretrain.clothing.gaits import CYCLES
from tools.pretrain.clothing.garments import Garment, neighbours, normals, tailored
from tools.pretrain.clothing.tables import Clip

SCRIPT = Path(__file__).parent / "blender" / "inside.py"
RUN_IN = 12
"""Frames from standing with the arms out to the cycle's middle, where the motion begins."""
SOLVER_FRAME = 1 / 25
"""Seconds that Blender's solver takes a frame to last."""
_OUT = Arm(abduction=42, elbow=4)
START = Pose(left_leg=Leg(abduction=6), right_leg=Leg(abduction=6), left_arm=_OUT, right_arm=_OUT)


@dataclass(frozen=True, eq=False)
class Person:
    """Someone at rest: vertices [V, 3], the mesh's polygons [F, 4], weights [V, J] and bones; `touched` [F] are the
    polygons that cloth can meet (the solver takes long over faces and fingers)."""

    rest: np.ndarray
    quads: np.ndarray
    weights: np.ndarray
    skeleton: Skeleton
    touched: np.ndarray


def part_way(start: object, end: object, share: Number) -> object:
    """Between two poses: every angle of theirs."""
    if not is_dataclass(start):
        return start + (end - start) * share
    return type(start)(**{f.name: part_way(getattr(start, f.name), getattr(end, f.name), share) for f in fields(start)})


def poses_of(clip: Clip) -> tuple[list[Pose], int]:
    """The poses that the solver walks through, half a cycle and a whole one at their end, and the frames of a cycle."""
    count = clip.fine * clip.frames
    cycle = [CYCLES[clip.motion](i / count, **clip.style) for i in range(count)]
    lead = cycle[len(cycle) // 2 :]
    run_in = [part_way(START, lead[0], share**2 * (3 - 2 * share)) for share in np.arange(RUN_IN) / RUN_IN]
    return [*run_in, *lead, *cycle], len(cycle)


def grounded(person: Person, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Bones' rotations and offsets, the pelvis over x = z = 0 and the lowest point at y = 0."""
    turned, offsets = bone_transforms(person.skeleton, pose)
    root = turned[0] @ person.skeleton.heads[0] + offsets[0]
    low = skinned(person.rest, person.weights, turned[None], offsets[None])[0, :, 1].min()
    return turned, offsets - [root[0], low, root[2]]


def skinned(rest: np.ndarray, weights: np.ndarray, turned: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Linear blend skinning in many frames: [V, 3], [V, J], [S, J, 3, 3], [S, J, 3] -> [S, V, 3]."""
    blended = np.tensordot(turned, weights, axes=(1, 1))  # [S, 3, 3, V]
    return np.einsum("sabv,vb->sva", blended, rest) + np.einsum("vj,sja->sva", weights, offsets)


def smooth_noise(garment: Garment, random: np.random.Generator, rounds: int) -> Float[np.ndarray, " G"]:
    """A smooth random field on the cloth, 0 to 1."""
    joined = neighbours(garment.quads, len(garment.vertices))
    count = joined.sum(1).A1
    field = random.standard_normal(len(count))
    for _ in range(rounds):
        field = (field + joined @ field) / (1 + count)
    low, high = np.percentile(field, [5, 95])
    return ((field - low) / (high - low)).clip(0, 1)


def draped(clip: Clip, person: Person, garments: list[Garment]) -> dict[str, np.ndarray]:
    """Of the clip's kept frames: the bones' `turned` [frames, J, 3, 3] and `offsets` [frames, J, 3], and each garment's
    vertices [frames, G, 3] by its name; metres."""
    poses, cycle = poses_of(clip)
    moved = [grounded(person, pose) for pose in poses]
    turned, offsets = np.stack([t for t, _ in moved]), np.stack([o for _, o in moved])
    skin = skinned(person.rest, person.weights, turned, offsets)
    kept = slice(len(poses) - cycle, None, cycle // clip.frames)
    found = {"turned": turned[kept], "offsets": offsets[kept]}
    met, local = np.unique(person.quads[person.touched], return_inverse=True)
    beneath, beneath_quads = skin[:, met], local.reshape(-1, 4)
    # Trousers first: the shirt hangs over them.
    for number, garment in sorted(enumerate(garments), reverse=True):
        random = np.random.default_rng([clip.wrinkles, number])
        wide = smooth_noise(garment, random, 4)
        rest = tailored(garment, person.rest, person.quads, 0.006 * smooth_noise(garment, random, 3))
        held = skinned(rest, person.weights[garment.vertices], turned, offsets)
        cloth = solve(clip, cycle, random, garment, held, wide, (beneath, beneath_quads))
        closed = _closed(cloth - skin[:, garment.vertices], cycle) + skin[-cycle:, garment.vertices]
        closed = outside(closed, beneath[-cycle:], beneath_quads)
        found[garment.name] = closed[:: cycle // clip.frames]
        beneath_quads = np.concatenate([beneath_quads, garment.quads + beneath.shape[1]])
        beneath = np.concatenate([beneath, cloth], axis=1)
    return found


def solve(
    clip: Clip,
    cycle: int,
    random: np.random.Generator,
    garment: Garment,
    held: np.ndarray,
    wide: np.ndarray,
    beneath: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """The garment through all frames [S, G, 3], by Blender."""
    told = {
        "garment": held.astype(np.float32),
        "quads": garment.quads,
        "pin": np.maximum(garment.pin, clip.hold if garment.name == "trousers" else 0.0),
        "wide": wide,
        "body": beneath[0].astype(np.float32),
        "body_quads": beneath[1],
        "time_scale": np.float64(clip.seconds / cycle / SOLVER_FRAME),
        "stiffness": np.float64(random.uniform(12, 20)),
        "bending": np.float64(random.uniform(0.02, 0.15)),
        "mass": np.float64(0.25),
        "growth": np.float64(random.uniform(0.12, 0.22)),
    }
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    with tempfile.TemporaryDirectory() as folder:
        environment["BLENDER_USER_RESOURCES"] = folder
        source, out = Path(folder) / "in.npz", Path(folder) / "out.npz"
        write_npz(source, **told)
        subprocess.run(
            [*blender_command("draping"), str(SCRIPT), "--", str(source), str(out)], env=environment, check=True
        )
        return read_npz(out)["cloth"].astype(np.float64)


def _closed(away: np.ndarray, cycle: int) -> np.ndarray:
    """The last cycle, whose end goes over into its beginning: in its last quarter it becomes what came before it."""
    share = np.clip((np.arange(cycle) / cycle - 0.75) / 0.25, 0, 1)[:, None, None]
    share = share**2 * (3 - 2 * share)
    before = np.concatenate([away[-cycle : -(cycle // 2)], away[-(cycle + cycle // 2) : -cycle]])[-cycle:]
    return (1 - share) * away[-cycle:] + share * before


def outside(cloth: np.ndarray, beneath: np.ndarray, quads: np.ndarray, least: float = 0.004) -> np.ndarray:
    """Cloth [S, G, 3] pushed out where it is nearer than `least` metres to what lies beneath it [S, V, 3], or in it."""
    pushed = cloth.copy()
    for now, below in zip(pushed, beneath, strict=True):
        outwards = normals(below, quads)
        far, near = cKDTree(below).query(now)
        height = ((now - below[near]) * outwards[near]).sum(1)
        # What is farther from the nearest vertex than polygons are wide lies beside the surface, not in it.
        inside = (height < least) & (far < 0.04)
        now[inside] += outwards[near[inside]] * (least - height[inside])[:, None]
    return pushed
