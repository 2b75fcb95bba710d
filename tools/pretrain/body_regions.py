"""Which part of the body a polygon of the sample mesh belongs to: for plain clothing colours, and as named regions.

Everything is decided once, in the average adult's rest pose (arms 45 degrees down), from skinning weights, heights and
normals, so that a region is the same set of polygons on every body.
"""

from __future__ import annotations

import numpy as np

from tools.pretrain.body_tables import PARTS

FACE_BONES = ("eye", "jaw", "special", "oris", "levator", "temporalis", "oculi", "risorius", "orbicularis")
BONE_GROUPS = {
    "head": ("head", "neck02", "neck03", *FACE_BONES),
    "hands": ("wrist", "metacarpal", "finger"),
    "feet": ("foot", "toe"),
    "arms": ("upperarm", "shoulder01"),
    "forearms": ("lowerarm",),
    "thighs": ("upperleg",),
    "shins": ("lowerleg",),
    "torso": ("spine", "breast", "clavicle", "root", "pelvis", "neck01"),
}

# Share of the height (from the soles) where the shirt ends, and where the chest ends and the belly begins.
WAIST, CHEST = 0.585, 0.615
# A normal's least forward component in the rest pose; above 0, so that what is only seen from the side is left out.
FORWARD = 0.12


def bone_group_of(quads: np.ndarray, weights: np.ndarray, bone_names: list[str]) -> np.ndarray:
    """[F] strings: the group of bones that moves each polygon most."""
    groups = list(BONE_GROUPS)
    moved = np.zeros((len(weights), len(groups)))
    for bone, name in enumerate(bone_names):
        group = next(i for i, prefixes in enumerate(BONE_GROUPS.values()) if name.startswith(prefixes))
        moved[:, group] += weights[:, bone]
    return np.array(groups)[moved[quads].sum(axis=1).argmax(axis=1)]


def polygon_frames(vertices: np.ndarray, quads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres [F, 3] and unit normals [F, 3] of quads."""
    corners = vertices[quads]
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    return corners.mean(axis=1), normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def body_parts(
    vertices: np.ndarray, quads: np.ndarray, weights: np.ndarray, bone_names: list[str], segments: dict[str, np.ndarray]
) -> np.ndarray:
    """[F] index into PARTS, the pieces that an outfit colours one by one.

    `segments` are Anny's own masks of eyes and mouth. Vertices [V, 3] are the rest pose's, metres, y up.
    """
    group = bone_group_of(quads, weights, bone_names)
    centre, _ = polygon_frames(vertices, quads)
    low, high = vertices[:, 1].min(), vertices[:, 1].max()
    height = (centre[:, 1] - low) / (high - low)
    part = np.full(len(quads), PARTS.index("torso"))
    for name in ("head", "hands", "feet", "thighs", "shins", "forearms", "arms"):
        part[group == name] = PARTS.index(name)
    # The waistband is level: the thighs' bones reach above it at the sides, the spine's below it in the middle.
    part[(group == "torso") & (height < WAIST)] = PARTS.index("hips")
    part[(group == "thighs") & (height >= WAIST)] = PARTS.index("torso")
    # A collar: what the neck's lowest bone and the collar bones move above the shoulders is skin.
    part[(group == "torso") & (height > 0.853)] = PARTS.index("head")
    head = part == PARTS.index("head")
    ears = head & (np.abs(centre[:, 0]) > 0.082)
    crown = head & ~ears & hair_line(centre, height)
    part[crown] = PARTS.index("hair")
    for name, mask in segments.items():
        if name.startswith("eye"):
            part[mask] = PARTS.index("eyes")
        elif name == "mouth_cavity":
            part[mask] = PARTS.index("mouth")
    return part


def hair_line(centre: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Above a line that runs from the forehead over the ears down to the nape."""
    front = (centre[:, 2] - np.percentile(centre[height > 0.93, 2], 2)) / 0.19
    return height > np.clip(0.895 + 0.062 * front, 0.9, 0.965)


def named_regions(vertices: np.ndarray, quads: np.ndarray, part: np.ndarray) -> dict[str, np.ndarray]:
    """Boolean masks [F] by name; see cloak_core/core/logo.py for how they combine."""
    centre, normal = polygon_frames(vertices, quads)
    low, high = vertices[:, 1].min(), vertices[:, 1].max()
    height = (centre[:, 1] - low) / (high - low)
    front = normal[:, 2] > FORWARD
    is_part = {name: part == index for index, name in enumerate(PARTS)}
    trunk = is_part["torso"] | is_part["hips"]
    return {
        "front": front,
        "chest": is_part["torso"] & front & (height > CHEST),
        "belly": trunk & front & (height <= CHEST) & (height > 0.53),
        "back": is_part["torso"] & ~front,
        "thighs": is_part["thighs"],
        "shins": is_part["shins"],
        "arms": is_part["arms"],
        "forearms": is_part["forearms"],
        "shirt": is_part["torso"] | is_part["arms"] | is_part["forearms"],
        "trousers": is_part["hips"] | is_part["thighs"] | is_part["shins"],
        "head": is_part["head"] | is_part["hair"] | is_part["eyes"] | is_part["mouth"],
        "hands": is_part["hands"],
        "feet": is_part["feet"],
    }
