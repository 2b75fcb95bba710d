"""Who in a photograph can be dressed, told from her annotation alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from cloak_core.files.errors import InputError
from cloak_core.sources.photographs.annotation import (
    LIMBS,
    SEEN,
    Landmarks,
    draw_mask,
    numbers,
    read_landmarks,
    read_mask,
)
from cloak_core.sources.photographs.person import Box

LEAST_HEIGHT = 96
MISPLACED = 0.7
"""Larger sides of a box by which landmarks may lie outside of it: the crop around her reaches 0.7 beyond every edge."""


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
        segmentation, box = annotation.get("segmentation"), boxes[number]
        outline = read_mask(segmentation, size[1], size[0], what) if segmentation else None
        landmarks = read_landmarks(annotation, what)
        reason = _why_left_out(annotation, landmarks, box, size)
        if not reason:
            mask = draw_mask(outline, size[1], size[0])
            reason = _why_mask(mask, landmarks)
        if reason:
            left_out.append((what, reason))
            continue
        _check_place(box, landmarks, what)
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


def _why_left_out(annotation: dict, landmarks: Landmarks | None, box: Box, size: tuple[int, int]) -> str:
    """Say why a person cannot be dressed, whatever her mask covers; "" where nothing speaks against it."""
    if annotation.get("iscrowd"):
        return "crowd"
    if not annotation.get("segmentation"):
        return "no mask"
    if landmarks is None:
        return "no landmarks"
    if box[3] - box[1] < LEAST_HEIGHT:
        return "small"
    unseen = landmarks.visibility[list(LIMBS)] < SEEN
    if unseen[:6].any():
        return "hidden"
    xy = landmarks.xy[list(LIMBS)]
    is_outside = (xy.min(axis=0) < -8).any() or (xy.max(axis=0) > np.add(size, 8)).any()
    if is_outside or unseen[6:].any() or box[0] < 1 or box[2] > size[0] - 1:
        return "cut"
    # Shoulders, hips, knees and ankles follow each other downwards.
    levels = xy[:, 1].reshape(4, 2).mean(axis=1)
    return "" if (levels[1:] >= levels[:-1] - 0.1 * (box[3] - box[1])).all() else "not upright"


def _why_mask(mask: Bool[np.ndarray, "h w"], landmarks: Landmarks) -> str:
    """Say why her mask, or her pose, speaks against it; "" where neither does."""
    if not mask.any():
        return "no mask"
    at = np.clip(np.rint(landmarks.xy[list(LIMBS)]).astype(int), 0, np.subtract(mask.shape[::-1], 1))
    if mask[at[:, 1], at[:, 0]].mean() < 0.7:
        return "hidden"
    # Somebody sits whose thighs are both far from hanging down, as long as the trunk leads one to expect them.
    shoulder, hip, knee, _ = landmarks.xy[list(LIMBS), 1].reshape(4, 2)
    trunk = abs(hip.mean() - shoulder.mean())
    return "sitting" if (knee - hip < 0.54 * trunk).all() else ""


def _check_place(box: Box, landmarks: Landmarks, what: str) -> None:
    """Check that a box holds its landmarks. InputError: most seen ones lie far from it.

    That is so where rows of two files were mixed up: nothing of the body would lie in the crop around the box.
    """
    seen = landmarks.xy[landmarks.visibility >= SEEN]
    low, high = np.array(box[:2]), np.array(box[2:])
    margin = MISPLACED * (high - low).max()
    inside = ((seen >= low - margin) & (seen <= high + margin)).all(axis=1)
    if len(seen) and inside.mean() < 0.5:
        x, y = np.median(seen, axis=0)
        raise InputError(f"{what}: bbox lies elsewhere than its landmarks, which are around {x:.0f}, {y:.0f}")
