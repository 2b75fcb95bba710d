"""What an annotation says of a person: landmarks, COCO's 17 or BlazePose's 33 as one set of joints, and her mask as
COCO writes it: polygons, run lengths, and run lengths packed into a string."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw

from cloak_core.files.errors import InputError

JOINTS = ("nose", "ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "heel", "toe", "hand")
NAMES = tuple(f"{side}_{joint}" if joint != "nose" else joint for joint in JOINTS for side in "lr")[1:]
"""nose, l_ear, r_ear, ...: l is the person's own left; hand is the index finger's first joint."""
INDEX = {name: number for number, name in enumerate(NAMES)}
BLAZEPOSE = (0, 7, 8, 11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 19, 20)
COCO = (0, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16)
LIMBS = tuple(INDEX[f"{side}_{joint}"] for joint in ("shoulder", "hip", "knee", "ankle") for side in "lr")
"""Without these nobody can be dressed."""
SEEN = 0.3
"""Visibility from which a landmark counts as seen."""
MAX_SIDE = 1 << 14


Outline = list[np.ndarray] | list[int]
"""Polygons [N, 2] of x, y, or run lengths by column, zeros first."""


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Where a person's joints are, in the order of `NAMES`."""

    xy: Float[np.ndarray, "21 2"]
    """Pixels."""
    depth: Float[np.ndarray, " 21"] | None
    """Pixels towards the camera, against the hips; None where the source tells none (COCO)."""
    visibility: Float[np.ndarray, " 21"]
    """0 (a guess) to 1; 0 also for what the source does not have."""

    def moved(self, origin: tuple[float, float], scale: float) -> Landmarks:
        """The landmarks in a picture cropped at `origin` and then resized by `scale`."""
        depth = None if self.depth is None else self.depth * scale
        return Landmarks((self.xy - np.asarray(origin)) * scale, depth, self.visibility)


def read_landmarks(annotation: dict, what: str) -> Landmarks | None:
    """The landmarks of a COCO annotation ("blazepose" or "keypoints"); None where it has none.

    `InputError` names `what` for lists of another length and for numbers that are none.
    """
    if annotation.get("blazepose"):
        return _from_blazepose(annotation["blazepose"], f"{what}: blazepose")
    keypoints = annotation.get("keypoints")
    if not keypoints:
        return None
    points = numbers(keypoints, f"{what}: keypoints")
    if points.size != 51:
        raise InputError(f"{what}: {points.size} numbers of keypoints, COCO has 17 of three (x, y, visibility)")
    points = points.reshape(17, 3)
    if not points[:, 2].any():
        return None
    if points[:, 2].min() < 0 or points[:, 2].max() > 2:
        raise InputError(
            f"{what}: keypoints: visibility {points[:, 2].max():g}; the order is x, y, visibility (0 to 2)"
        )
    xy, visibility = np.zeros((len(NAMES), 2)), np.zeros(len(NAMES))
    xy[: len(COCO)] = points[COCO, :2]
    # COCO writes 1 for hidden and 2 for seen; pose estimators write their confidence in [0, 1].
    known = points[COCO, 2]
    visibility[: len(COCO)] = np.where(known > 1, 1.0, known * (0.5 if points[:, 2].max() > 1 else 1.0))
    return Landmarks(xy, None, visibility)


def _from_blazepose(record: object, what: str) -> Landmarks:
    if not isinstance(record, dict) or "xy" not in record:
        raise InputError(f"{what}: no 'xy' in it")
    arrays: dict[str, np.ndarray] = {}
    for name, width in (("xy", 2), ("visibility", 1), ("world", 3), ("z", 1)):
        if not record.get(name) and name != "xy":
            continue
        array = numbers(record[name], what)
        if array.size != 33 * width:
            raise InputError(f"{what}: {array.size} numbers in '{name}', 33 landmarks have {33 * width}")
        arrays[name] = array.reshape(33, width)[list(BLAZEPOSE)]
    xy, world = arrays["xy"], arrays.get("world")
    visibility = arrays["visibility"][:, 0] if "visibility" in arrays else np.ones(len(BLAZEPOSE))
    depth = -arrays["z"][:, 0] if "z" in arrays else None
    if world is not None:  # metres: as large as the landmarks lie apart in the picture
        flat = world[:, :2] - world[:, :2].mean(axis=0)
        size = np.linalg.norm(xy - xy.mean(axis=0)) / max(float(np.linalg.norm(flat)), 1e-9)
        depth = -world[:, 2] * size
    return Landmarks(xy, depth, visibility)


def read_mask(segmentation: object, height: int, width: int, what: str) -> Outline:
    """Read a COCO segmentation, without drawing it: a tenth of the time.

    segmentation: a list of polygons [x, y, x, y, ...], or {"size": [h, w], "counts": list or packed string}. `what`
    names annotation and file in the `InputError` that a broken or misplaced segmentation raises.
    """
    if not isinstance(segmentation, list):
        return _run_lengths(segmentation, height, width, what)
    polygons = []
    for polygon in segmentation:
        if not isinstance(polygon, list) or len(polygon) < 6 or len(polygon) % 2:
            raise InputError(f"{what}: a polygon is a list of at least three x, y")
        points = numbers(polygon, what).reshape(-1, 2)
        # COCO's own polygons reach a pixel beyond the border here and there.
        if points.min() < -2 or (points.max(axis=0) > (width + 2, height + 2)).any():
            raise InputError(f"{what}: a polygon lies outside the photograph ({width} x {height})")
        polygons.append(points)
    return polygons


def draw_mask(outline: Outline, height: int, width: int) -> Bool[np.ndarray, "h w"]:
    """Draw a segmentation as a mask of the picture's size."""
    if outline and isinstance(outline[0], int):
        values = np.repeat(np.arange(len(outline)) % 2 == 1, outline)
        return values.reshape(width, height).T.copy()
    picture = Image.new("1", (width, height))
    draw = ImageDraw.Draw(picture)
    for points in outline:
        draw.polygon([tuple(point) for point in points.tolist()], fill=1)
    return np.array(picture)


def _run_lengths(segmentation: object, height: int, width: int, what: str) -> list[int]:
    if not isinstance(segmentation, dict) or "counts" not in segmentation or "size" not in segmentation:
        raise InputError(f"{what}: segmentation is neither polygons nor run lengths")
    if segmentation["size"] != [height, width]:
        raise InputError(f"{what}: its mask has size {segmentation['size']}, the photograph [{height}, {width}]")
    counts = segmentation["counts"]
    if isinstance(counts, str):
        counts = _unpack_counts(counts, what)
    if not isinstance(counts, list) or not all(isinstance(c, int) and c >= 0 for c in counts):
        raise InputError(f"{what}: run lengths are not a list of numbers from 0")
    if sum(counts) != height * width:
        raise InputError(f"{what}: run lengths add up to {sum(counts)}, the photograph has {height * width} pixels")
    return counts


def _unpack_counts(packed: str, what: str) -> list[int]:
    """COCO's packed run lengths: 5 bits a character from 48 on, differences to the count before last from the third."""
    counts: list[int] = []
    value = shift = 0
    for character in packed.encode("utf-8", "replace"):
        bits = character - 48
        if not 0 <= bits < 64 or shift > 30:
            raise InputError(f"{what}: broken run lengths (character {len(counts)})")
        value |= (bits & 31) << shift
        shift += 5
        if bits & 32:
            continue
        if bits & 16:
            value -= 1 << shift
        counts.append(value + (counts[-2] if len(counts) > 2 else 0))
        value = shift = 0
    if shift:
        raise InputError(f"{what}: run lengths end in the middle of a number")
    return counts


def numbers(values: object, what: str) -> np.ndarray:
    """Finite float64 numbers from a JSON list. `InputError` names `what` where they are none."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what}: not a list of numbers") from None
    if not np.isfinite(array).all():
        raise InputError(f"{what}: a number is not finite")
    return array
