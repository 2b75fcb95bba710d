"""Who in a photograph can be dressed, told from her annotation alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from cloak_core.files.errors import InputError
from cloak_core.sources.photographs.coco_reader import check_place
from cloak_core.sources.photographs.landmarks import INDEX, LIMBS, SEEN, Landmarks, is_upright, read_landmarks
from cloak_core.sources.photographs.masks import check_mask, decode_mask, numbers

LEAST_HEIGHT = 96
Box = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Dressable:
    """Somebody who can be dressed, in pixels of her whole photograph."""

    number: int
    """The annotation's id."""
    what: str
    """How messages call her."""
    mask: Bool[np.ndarray, "h w"]
    box: Box
    landmarks: Landmarks
    others: tuple[Box, ...]
    """Boxes of the other annotated people."""


def choose(
    annotations: list[dict], size: tuple[int, int], names: list[str]
) -> tuple[list[Dressable], list[tuple[str, str]]]:
    """Choose who of a photograph's annotated people can be dressed.

    size: the photograph's width and height; names: how messages call the annotations. Returns them, and (name, reason)
    of everybody else. InputError: an annotation is broken, also of those who are left out.
    """
    boxes = [_box(annotation, *size, what) for what, annotation in zip(names, annotations, strict=True)]
    chosen: list[Dressable] = []
    left_out: list[tuple[str, str]] = []
    for number, (what, annotation) in enumerate(zip(names, annotations, strict=True)):
        segmentation = annotation.get("segmentation")
        if segmentation:
            check_mask(segmentation, size[1], size[0], what)
        landmarks = read_landmarks(annotation, what)
        box = boxes[number]
        reason = why_left_out(annotation, landmarks, box, size)
        mask = None if reason else decode_mask(segmentation, size[1], size[0], what)
        if mask is not None:
            reason = _why_mask(mask, landmarks)
        if reason:
            left_out.append((what, reason))
            continue
        check_place(box, landmarks, what)
        others = tuple(b for i, b in enumerate(boxes) if i != number and not annotations[i].get("iscrowd"))
        chosen.append(Dressable(annotation["id"], what, mask, box, landmarks, others))
    return chosen, left_out


def _box(annotation: dict, width: int, height: int, what: str) -> Box:
    values = numbers(annotation.get("bbox"), f"{what}: bbox")
    if values.shape != (4,) or values[2:].min() < 0:
        raise InputError(f"{what}: bbox is not x, y, width, height")
    x, y, w, h = values.tolist()
    if x < -2 or y < -2 or x + w > width + 2 or y + h > height + 2:
        raise InputError(f"{what}: bbox lies outside the photograph ({width} x {height})")
    return x, y, x + w, y + h


def why_left_out(annotation: dict, landmarks: Landmarks | None, box: Box, size: tuple[int, int]) -> str:
    """Say why a person cannot be dressed, whatever her mask covers; "" where nothing speaks against it."""
    if annotation.get("iscrowd"):
        return "crowd"
    if not annotation.get("segmentation"):
        return "no mask"
    if landmarks is None:
        return "no landmarks"
    if box[3] - box[1] < LEAST_HEIGHT:
        return "small"
    if (landmarks.visibility[list(LIMBS[:6])] < SEEN).any():
        return "hidden"
    xy = landmarks.xy[list(LIMBS)]
    if (
        (xy.min(axis=0) < -8).any()
        or (xy.max(axis=0) > np.add(size, 8)).any()
        or (landmarks.visibility[list(LIMBS[6:])] < SEEN).any()
    ):
        return "cut"
    if box[0] < 1 or box[2] > size[0] - 1:
        return "cut"
    return "" if is_upright(landmarks, box[3] - box[1]) else "not upright"


def _why_mask(mask: Bool[np.ndarray, "h w"], landmarks: Landmarks) -> str:
    """Say why her mask, or her pose, speaks against it; "" where neither does."""
    if not mask.any():
        return "no mask"
    at = np.clip(np.rint(landmarks.xy[list(LIMBS)]).astype(int), 0, np.subtract(mask.shape[::-1], 1))
    if mask[at[:, 1], at[:, 0]].mean() < 0.7:
        return "hidden"
    return "sitting" if _sits(landmarks) else ""


def _sits(landmarks: Landmarks) -> bool:
    """Both thighs far from hanging down, as long as the trunk leads one to expect them."""
    at = lambda joint: landmarks.xy[[INDEX[f"l_{joint}"], INDEX[f"r_{joint}"]]]
    trunk = abs(at("hip").mean(axis=0)[1] - at("shoulder").mean(axis=0)[1])
    drop = (at("knee") - at("hip"))[:, 1]
    return bool((drop < 0.54 * trunk).all())
