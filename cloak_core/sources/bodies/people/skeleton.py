"""Posing a skinned body by the angles of its joints, for the sample bodies.

Angles are anatomical and in degrees, left and right alike: flexion moves a limb forwards (a knee's, backwards),
abduction away from the middle. Zero is standing upright, arms hanging, palms to the
thighs. Axes: y up, facing +z, left at +x.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from cloak_core.core.cameras import Number

DOWN = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True)
class Leg:
    hip: Number = 0.0
    abduction: Number = 3.0
    outward: Number = 6.0
    knee: Number = 3.0
    # The sole against the ground: 0 flat, positive with the heel up.
    heel_up: Number = 0.0


@dataclass(frozen=True)
class Arm:
    shoulder: Number = 0.0
    abduction: Number = 10.0
    # Turns the upper arm about itself: positive brings a bent forearm in front of the belly.
    inward: Number = 10.0
    elbow: Number = 12.0
    # Turns the palm, from facing the thigh (0) to facing backwards (90).
    pronation: Number = 10.0
    # Mean flexion of the finger joints.
    curl: Number = 14.0


@dataclass(frozen=True)
class Pose:
    left_leg: Leg = field(default_factory=Leg)
    right_leg: Leg = field(default_factory=Leg)
    left_arm: Arm = field(default_factory=Arm)
    right_arm: Arm = field(default_factory=Arm)
    # Of the pelvis: forwards, to the left, sideways to the left.
    lean: Number = 0.0
    turn: Number = 0.0
    tilt: Number = 0.0
    # Of the chest against the pelvis, spread over the spine.
    spine_lean: Number = 0.0
    spine_turn: Number = 0.0
    spine_tilt: Number = 0.0
    # Of the head against the world: where it looks.
    look_down: Number = 0.0
    look_left: Number = 0.0
    head_tilt: Number = 0.0


class Skeleton:
    """Bones in the rest pose: names, parents (-1 for the root) and heads [J, 3]; parents come before children."""

    def __init__(self, names: list[str], parents: list[int], heads: np.ndarray) -> None:
        self.names, self.parents, self.heads = names, parents, heads
        self.index = {name: i for i, name in enumerate(names)}

    def direction(self, start: str, end: str) -> np.ndarray:
        return unit(self.heads[self.index[end]] - self.heads[self.index[start]])


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def turn_about(axis: np.ndarray, degrees: Number) -> np.ndarray:
    """Make the rotation matrix about an axis."""
    return Rotation.from_rotvec(unit(axis) * degrees, degrees=True).as_matrix()


def about(axis: str, degrees: Number) -> np.ndarray:
    """Make the rotation matrix about "x", "y" or "z"."""
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def smallest_turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Find the rotation that carries one unit vector to another without twisting."""
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        return np.eye(3)
    return turn_about(axis, np.degrees(np.arctan2(sine, start @ end)))


def frame(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Make orthonormal columns: along, the part of across orthogonal to it, their cross product."""
    across = unit(across - along * (across @ along))
    return np.stack([along, across, np.cross(along, across)], axis=1)


def part_of(rotation: np.ndarray, share: Number) -> np.ndarray:
    """Take a share of a rotation, about the same axis."""
    return (Rotation.from_matrix(rotation) ** share).as_matrix()


def leg_rotations(skeleton: Skeleton, side: str, leg: Leg, pelvis: np.ndarray) -> dict[str, np.ndarray]:
    out = 1.0 if side == "L" else -1.0
    hip = pelvis @ about("x", -leg.hip) @ about("z", out * leg.abduction)
    turned = hip @ about("y", out * leg.outward)
    half_turned = hip @ about("y", out * leg.outward / 2)
    thigh = smallest_turn(skeleton.direction(f"upperleg01.{side}", f"lowerleg01.{side}"), DOWN)
    shin = smallest_turn(skeleton.direction(f"lowerleg01.{side}", f"foot.{side}"), DOWN)
    knee = turned @ about("x", leg.knee)
    # The sole keeps its pitch to the ground and only follows the leg's heading.
    toes = knee @ shin @ np.array([0.0, 0.0, 1.0])
    if leg.hip < -20 or leg.knee > 60:  # a shin near the horizontal has no heading of its own
        toes = turned @ np.array([0.0, 0.0, 1.0])
    heading = np.degrees(np.arctan2(toes[0], toes[2]))
    sole = about("y", heading) @ about("x", leg.heel_up)
    # Half of the groin's bend is the pelvis bone's on that side, so that the fold is soft.
    return {
        f"pelvis.{side}": pelvis @ part_of(pelvis.T @ hip @ thigh, 0.12),
        f"upperleg01.{side}": half_turned @ thigh,
        f"upperleg02.{side}": turned @ thigh,
        f"lowerleg01.{side}": knee @ shin,
        f"lowerleg02.{side}": knee @ shin,
        f"foot.{side}": sole,
    }


def arm_rotations(skeleton: Skeleton, side: str, arm: Arm, chest: np.ndarray) -> dict[str, np.ndarray]:
    out = 1.0 if side == "L" else -1.0
    upper = skeleton.direction(f"upperarm01.{side}", f"lowerarm01.{side}")
    lower = skeleton.direction(f"lowerarm01.{side}", f"wrist.{side}")
    # The elbow's hinge: bending turns the forearm about it, forwards.
    hinge = unit(np.cross(upper, lower))
    neutral = frame(DOWN, np.array([-1.0, 0.0, 0.0]))
    shoulder = chest @ about("x", -arm.shoulder) @ about("z", out * arm.abduction)
    swing = shoulder @ about("y", -out * arm.inward)
    bent = swing @ about("x", -arm.elbow)
    upper_rest, lower_rest = neutral @ frame(upper, hinge).T, neutral @ frame(lower, hinge).T
    palm = about("y", -out * arm.pronation)
    raised = max(arm.abduction - 60.0, 0.0) + max(arm.shoulder - 70.0, 0.0)
    lift = chest @ about("z", out * (-3.0 + 0.35 * raised))
    rotations = {
        f"clavicle.{side}": lift,
        f"shoulder01.{side}": lift @ about("z", out * -3.0),
        # The twist of the upper arm and the forearm grows along each, as muscles and skin do.
        f"upperarm01.{side}": between(lift, swing @ upper_rest, upper, 0.5),
        f"upperarm02.{side}": swing @ upper_rest,
        f"lowerarm01.{side}": bent @ lower_rest,
        f"lowerarm02.{side}": bent @ about("y", -out * arm.pronation / 2) @ lower_rest,
        f"wrist.{side}": bent @ palm @ lower_rest,
    }
    return rotations | finger_rotations(skeleton, side, arm.curl, rotations[f"wrist.{side}"])


def between(parent: np.ndarray, target: np.ndarray, along: np.ndarray, share: Number) -> np.ndarray:
    """Take `target` with only a share of its twist about `along` against the twist-free rotation from `parent`."""
    swing = smallest_turn(parent @ along, target @ along) @ parent
    return swing @ part_of(swing.T @ target, share)


def finger_rotations(skeleton: Skeleton, side: str, curl: Number, wrist: np.ndarray) -> dict[str, np.ndarray]:
    # Across the palm, from the index to the little finger on the left hand, mirrored on the right.
    across = skeleton.direction(f"finger2-1.{side}", f"finger5-1.{side}") * (1.0 if side == "L" else -1.0)
    rotations = {}
    for finger in range(2, 6):
        joints = [f"finger{finger}-{joint}.{side}" for joint in (1, 2, 3)]
        along = skeleton.direction(joints[0], joints[1])
        hinge = across - along * (across @ along)
        for joint, total in zip(joints, (0.8, 1.9, 2.7), strict=True):
            rotations[joint] = wrist @ turn_about(hinge, total * curl)
    return rotations


def bone_rotations(skeleton: Skeleton, pose: Pose) -> dict[str, np.ndarray]:
    """Compute world rotations (against the rest pose) of the bones that a pose sets; others follow their parents."""
    pelvis = about("y", pose.turn) @ about("x", pose.lean) @ about("z", -pose.tilt)
    rotations = {"root": pelvis}
    chest = pelvis
    spine = about("y", pose.spine_turn) @ about("x", pose.spine_lean) @ about("z", -pose.spine_tilt)
    for bone in ("spine05", "spine04", "spine03", "spine02", "spine01"):
        chest = chest @ part_of(spine, 0.2)
        rotations[bone] = chest
    head = about("y", pose.look_left) @ about("x", pose.look_down) @ about("z", -pose.head_tilt)
    for bone, share in (("neck01", 0.25), ("neck02", 0.5), ("neck03", 0.75), ("head", 1.0)):
        rotations[bone] = chest @ part_of(chest.T @ head, share)
    for side, leg, arm in (("L", pose.left_leg, pose.left_arm), ("R", pose.right_leg, pose.right_arm)):
        rotations |= leg_rotations(skeleton, side, leg, pelvis) | arm_rotations(skeleton, side, arm, chest)
    return rotations


def bone_transforms(skeleton: Skeleton, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Compute what a pose does to each bone: rotations [J, 3, 3] and offsets [J, 3], metres.

    A point p at rest goes to rotation @ p + offset.
    """
    given = bone_rotations(skeleton, pose)
    turned = np.zeros((len(skeleton.names), 3, 3))
    heads = np.zeros_like(skeleton.heads)
    for bone, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents, strict=True)):
        if parent < 0:
            turned[bone], heads[bone] = given.get(name, np.eye(3)), skeleton.heads[bone]
            continue
        turned[bone] = given.get(name, turned[parent])
        heads[bone] = heads[parent] + turned[parent] @ (skeleton.heads[bone] - skeleton.heads[parent])
    return turned, heads - np.einsum("jab,jb->ja", turned, skeleton.heads)


def pose_vertices(vertices: np.ndarray, weights: np.ndarray, skeleton: Skeleton, pose: Pose) -> np.ndarray:
    """Skin the body (linear blend): rest vertices [V, 3], weights [V, J] -> posed vertices [V, 3]."""
    turned, offsets = bone_transforms(skeleton, pose)
    blended = np.einsum("vj,jab->vab", weights, turned)
    return np.einsum("vab,vb->va", blended, vertices) + weights @ offsets
