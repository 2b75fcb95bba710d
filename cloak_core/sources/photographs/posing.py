"""A body posed to a person's landmarks: each limb turned and stretched so that its joints lie where the photograph
has them, under an orthographic camera.

View space: x to the right, y up, z towards the camera, all in pixels of the person's crop.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from cloak_core.core.cameras import Number
from cloak_core.sources.bodies.people.skeleton import smallest_turn, unit
from cloak_core.sources.photographs.annotation import INDEX, SEEN, Landmarks
from cloak_core.sources.photographs.rig import SEGMENTS, Rig

LENGTHS = (0.85, 1.2)
"""How much shorter or longer than the rig's a limb may be before its depth gives way."""
HIDDEN = 0.5
"""Visibility below which an arm is taken to be behind the person."""
UPWARD, FORWARD = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
LEAST_SCALE, TINY = 1.0, 1e-9
"""Pixels per metre, and pixels: less is of landmarks that fall together."""
LIMBS = {
    "arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "thigh": ("hip", "knee"),
    "shin": ("knee", "ankle"),
}
Joints = dict[str, Float[np.ndarray, " 3"]]
"""Places in view space, by the names of `annotation.NAMES`."""
_BENT = {"arm": 0.0, "forearm": 1.0, "thigh": 1.0, "shin": -1.0}
"""Which way a limb leans where nobody tells its depth: forwards or backwards."""


@dataclass(frozen=True, eq=False)
class Posed:
    """What the fit makes of a person."""

    transforms: Float[np.ndarray, "S 3 4"]
    """Of each of `SEGMENTS`: rest metres -> view space."""
    scale: Number
    """Pixels per metre of the rig."""

    def vertices(self, rig: Rig) -> Float[np.ndarray, "V 3"]:
        """The rig's vertices in view space, by linear blend skinning."""
        blended = np.einsum("vs,sab->vab", rig.weights, self.transforms)
        return np.einsum("vab,vb->va", blended[:, :, :3], rig.vertices) + blended[:, :, 3]

    def joint(self, rig: Rig, name: str, segment: str) -> Float[np.ndarray, " 3"]:
        """Where a segment takes one of the rig's joints."""
        transform = self.transforms[SEGMENTS.index(segment)]
        return transform[:, :3] @ rig.joints[name] + transform[:, 3]


def pose_to(landmarks: Landmarks, rig: Rig, widths: Mapping[str, float] | None = None) -> Posed:
    """Pose the rig's body to the landmarks.

    widths: how much wider than the rig's each segment is, across its length (1 where absent).
    """
    widths = widths or {}
    depth = np.zeros(len(INDEX)) if landmarks.depth is None else landmarks.depth
    seen = dict(zip(INDEX, np.column_stack([landmarks.xy * (1, -1), depth]), strict=True))
    scale = _pixels_per_metre(landmarks, seen, rig)
    at = _joints_in_view(landmarks, seen, rig, scale)
    middle = lambda joints, name: (joints[f"l_{name}"] + joints[f"r_{name}"]) / 2
    frames: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    turned: dict[str, np.ndarray] = {}
    along = middle(at, "shoulder") - middle(at, "hip")
    rest_along = middle(rig.joints, "shoulder") - middle(rig.joints, "hip")
    for segment, joint in (("pelvis", "hip"), ("chest", "shoulder")):
        across = at[f"l_{joint}"] - at[f"r_{joint}"]
        rest_across = np.linalg.norm(rig.joints[f"l_{joint}"] - rig.joints[f"r_{joint}"])
        ahead = _unit(np.cross(across, along), FORWARD)
        up = _unit(along, UPWARD)
        turned[segment] = np.stack([np.cross(up, ahead), up, ahead], axis=1)
        width = widths.get(segment, 1.0)
        columns = (across / rest_across * width, along / rest_along[1], ahead * scale * width)
        frames[segment] = (np.stack(columns, axis=1), middle(at, joint), middle(rig.joints, joint))
    for side in "lr":
        parent = {"arm": "chest", "forearm": f"{side}_arm", "thigh": "pelvis", "shin": f"{side}_thigh"}
        for limb, (start, end) in LIMBS.items():
            name = f"{side}_{limb}"
            rest = rig.joints[f"{side}_{end}"] - rig.joints[f"{side}_{start}"]
            posed = at[f"{side}_{end}"] - at[f"{side}_{start}"]
            hanging = unit(turned[parent[limb]] @ rest)
            turned[name] = smallest_turn(hanging, _unit(posed, hanging)) @ turned[parent[limb]]
            # Along itself a limb is as long as its landmarks say, across as wide as its part of the mask.
            axis = np.outer(unit(rest), unit(rest))
            length = np.linalg.norm(posed) / np.linalg.norm(rest)
            stretched = scale * widths.get(name, 1.0) * (np.eye(3) - axis) + length * axis
            frames[name] = (turned[name] @ stretched, at[f"{side}_{start}"], rig.joints[f"{side}_{start}"])
        for part, end, turn in (
            ("hand", "wrist", _hand(landmarks, seen, at, rig, side, turned[f"{side}_forearm"])),
            ("foot", "ankle", _foot(landmarks, seen, side, turned["pelvis"], scale)),
        ):
            frames[f"{side}_{part}"] = (turn * scale, at[f"{side}_{end}"], rig.joints[f"{side}_{end}"])
    frames["head"] = _head(landmarks, seen, rig, turned["chest"], frames["chest"], scale)
    transforms = np.zeros((len(SEGMENTS), 3, 4))
    for number, segment in enumerate(SEGMENTS):
        matrix, place, origin = frames[segment]
        transforms[number, :, :3], transforms[number, :, 3] = matrix, place - matrix @ origin
    return Posed(transforms, scale)


def seen_from(landmarks: Landmarks, rig: Rig) -> str:
    """From where a photograph sees a person: "front", "side" or "back" of her chest, to within 45 degrees."""
    chest = pose_to(landmarks, rig).transforms[SEGMENTS.index("chest")]
    away = abs(np.degrees(np.arctan2(chest[0, 2], chest[2, 2])))
    return "front" if away <= 45 else "back" if away >= 135 else "side"


def _unit(vector: np.ndarray, otherwise: np.ndarray) -> Float[np.ndarray, " 3"]:
    """Normalise a vector; `otherwise` where landmarks that fall together leave it no direction."""
    return unit(vector) if np.linalg.norm(vector) > TINY else otherwise


def _pixels_per_metre(landmarks: Landmarks, seen: Joints, rig: Rig) -> float:
    """From the lengths of trunk and limbs: their median where depth is known, else nearly the largest of them.

    Weak perspective: one scale for the whole person. Without depth a limb looks shorter the more it points at the
    camera and never longer, so the longest ones tell the scale; not the very longest, whose landmarks may be wrong.
    """
    ratios = []
    for side in "lr":
        for start, end in (*LIMBS.values(), ("hip", "shoulder")):
            one, other = f"{side}_{start}", f"{side}_{end}"
            if min(landmarks.visibility[INDEX[one]], landmarks.visibility[INDEX[other]]) < SEEN:
                continue
            rest = np.linalg.norm(rig.joints[one] - rig.joints[other])
            ratios.append(np.linalg.norm(seen[one] - seen[other]) / rest)
    return max(float(np.percentile(ratios, 50 if landmarks.depth is not None else 75)), LEAST_SCALE)


def _joints_in_view(landmarks: Landmarks, seen: Joints, rig: Rig, scale: Number) -> Joints:
    """The joints' places, in the picture exactly the landmarks', with depths that give limbs possible lengths."""
    at: Joints = {}
    nose = seen["nose"][0] - (seen["l_shoulder"] + seen["r_shoulder"])[0] / 2
    faces = 1.0 if seen["l_shoulder"][0] >= seen["r_shoulder"][0] else -1.0
    tells_depth = landmarks.depth is not None
    for joint in ("hip", "shoulder"):
        left, right = f"l_{joint}", f"r_{joint}"
        length = np.linalg.norm(rig.joints[left] - rig.joints[right]) * scale
        across = _with_length(seen[left] - seen[right], length, -np.sign(nose), not tells_depth)
        middle = (seen[left] + seen[right]) / 2
        at[left], at[right] = middle + across / 2, middle - across / 2
    for side in "lr":
        for limb, (start, end) in LIMBS.items():
            one, other = f"{side}_{start}", f"{side}_{end}"
            rest = float(np.linalg.norm(rig.joints[one] - rig.joints[other]))
            if landmarks.visibility[INDEX[other]] <= 0 and end in ("elbow", "wrist"):
                at[other] = at[one] + np.array([0.0, -rest * scale, 0.0])  # hangs down, out of sight
                continue
            at[other] = at[one] + _with_length(seen[other] - seen[one], rest * scale, _BENT[limb] * faces)
        left, right = sorted((at["l_shoulder"][0], at["r_shoulder"][0]))
        for joint in ("elbow", "wrist"):
            place = at[f"{side}_{joint}"]
            # A forearm that crosses the trunk lies before it, whoever measured no depth.
            if not tells_depth and left < place[0] < right and place[1] > at["l_hip"][1]:
                place[2] = max(place[2], 0.16 * scale) if faces > 0 else place[2] - 0.2 * scale
            # What the photograph does not show lies behind what it shows.
            if landmarks.visibility[INDEX[f"{side}_{joint}"]] < HIDDEN:
                place[2] = min(place[2], at["l_hip"][2], at["r_hip"][2]) - 0.25 * scale
    return at


def _with_length(vector: np.ndarray, length: Number, sign: Number, exact: bool = False) -> Float[np.ndarray, " 3"]:
    """The vector with its depth changed so that it is as long as a limb can be; `sign`: of a depth not known."""
    flat = np.linalg.norm(vector[:2])
    least, most = (0.97, 1.2) if exact else LENGTHS
    wanted = np.clip(np.linalg.norm(vector), least * length, most * length)
    depth = np.sqrt(max(wanted**2 - flat**2, 0.0))
    return np.array([vector[0], vector[1], (np.sign(vector[2]) or sign) * depth])


def _head(
    landmarks: Landmarks, seen: Joints, rig: Rig, chest: np.ndarray, torso: tuple, scale: Number
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turned to where the ears (or the nose) are, begun at the neck."""
    matrix, place, origin = torso
    neck = place + matrix @ (rig.joints["neck"] - origin)
    known = [name for name in ("l_ear", "r_ear", "nose") if landmarks.visibility[INDEX[name]] >= SEEN]
    known = known[:2] if len(known) == 3 else known
    if not known:
        return chest * scale, neck, rig.joints["neck"]
    towards = np.append(np.mean([seen[name][:2] for name in known], axis=0), neck[2]) - neck
    rest = rig.joints["head"] + np.array([0.0, 0.03, 0.02]) - rig.joints["neck"]
    size = np.clip(np.linalg.norm(towards) / np.linalg.norm(rest), 0.8 * scale, 1.25 * scale)
    return smallest_turn(unit(chest @ rest), _unit(towards, UPWARD)) @ chest * size, neck, rig.joints["neck"]


def _foot(landmarks: Landmarks, seen: Joints, side: str, pelvis: np.ndarray, scale: Number) -> Float[np.ndarray, "3 3"]:
    """Turned to where heel and toes are; without them, ahead."""
    heel, toe = f"{side}_heel", f"{side}_toe"
    towards = seen[toe] - seen[heel]
    if min(landmarks.visibility[[INDEX[heel], INDEX[toe]]]) < SEEN or np.linalg.norm(towards) < 0.02 * scale:
        return pelvis
    return smallest_turn(pelvis @ FORWARD, unit(towards)) @ pelvis


def _hand(
    landmarks: Landmarks, seen: Joints, at: Joints, rig: Rig, side: str, forearm: np.ndarray
) -> Float[np.ndarray, "3 3"]:
    """Turned to where the index finger is; without it, in line with the forearm."""
    wrist = at[f"{side}_wrist"]
    towards = np.append(seen[f"{side}_hand"][:2], wrist[2]) - wrist
    if landmarks.visibility[INDEX[f"{side}_hand"]] < HIDDEN or np.linalg.norm(towards) < 2:
        return forearm
    rest = rig.joints[f"{side}_wrist"] - rig.joints[f"{side}_elbow"]
    return smallest_turn(unit(forearm @ rest), unit(towards)) @ forearm
