"""People simulated from those at hand: mirrored, scaled, cropped, recoloured, each in a photograph of her own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image

from cloak_core.files.writing import write_json
from cloak_core.sources.photographs.landmarks import BLAZEPOSE, NAMES, Landmarks
from cloak_core.sources.photographs.people import People
from cloak_core.sources.photographs.person import Person

LEAST, MOST = 110, 400
"""Heights of simulated people, pixels."""
SHARD = 1000
"""People of one file."""
_SIDES = {"l": "r", "r": "l"}
_MIRRORED = [
    NAMES.index(f"{_SIDES[name[0]]}{name[1:]}") if name[1] == "_" else number for number, name in enumerate(NAMES)
]


@dataclass(frozen=True, eq=False)
class _Simulated:
    image: UInt8[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w"]
    landmarks: Landmarks


def write_simulated(people: People, count: int, folder: Path, seed: int = 0) -> Path:
    """Write `count` people in COCO's format, `SHARD` a file, and the list of these files, which is returned.

    Everybody has a photograph of her own. One in a thousand or two falls out for a landmark at the border.
    """
    folder.mkdir(parents=True)
    names = []
    for start in range(0, count, SHARD):
        images, annotations = [], []
        for number in range(start, min(start + SHARD, count)):
            random = np.random.default_rng([seed, number])
            made = _simulated(people.people[number % len(people)], random)
            height, width = made.mask.shape
            Image.fromarray(made.image).save(folder / f"{number}.jpg", quality=90)
            images.append({"id": number, "file_name": f"{number}.jpg", "width": width, "height": height})
            annotations.append(_annotation(made, number))
        names.append(f"people-{start // SHARD}.json")
        write_json(folder / names[-1], {"images": images, "annotations": annotations})
    path = folder / "people.txt"
    path.write_text("\n".join(names) + "\n", encoding="utf-8")
    return path


def _simulated(person: Person, random: np.random.Generator) -> _Simulated:
    image, mask, landmarks = person.image, person.mask, person.landmarks
    if random.random() < 0.5:
        image, mask, landmarks = image[:, ::-1], mask[:, ::-1], _mirrored(landmarks, mask.shape[1])
    image, mask, landmarks = _cropped(image, mask, landmarks, random)
    y = np.flatnonzero(mask.any(axis=1))
    scale = random.uniform(0.7, 1.15)
    scale = float(np.clip(scale, LEAST / (y[-1] + 1 - y[0]), MOST / (y[-1] + 1 - y[0])))
    size = round(image.shape[1] * scale), round(image.shape[0] * scale)
    gains = random.uniform(0.75, 1.25, 3)
    bright = np.clip(image * gains, 0, 255).astype(np.uint8)
    return _Simulated(
        np.array(Image.fromarray(bright).resize(size, Image.Resampling.BILINEAR)),
        np.array(Image.fromarray(np.ascontiguousarray(mask)).resize(size, Image.Resampling.NEAREST)),
        landmarks.moved((0.0, 0.0), scale),
    )


def _mirrored(landmarks: Landmarks, width: int) -> Landmarks:
    xy = landmarks.xy[_MIRRORED] * (-1, 1) + (width, 0)
    depth = None if landmarks.depth is None else landmarks.depth[_MIRRORED]
    return Landmarks(xy, depth, landmarks.visibility[_MIRRORED])


def _cropped(
    image: np.ndarray, mask: np.ndarray, landmarks: Landmarks, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, Landmarks]:
    """Cut away some of what lies around her, on each side another share."""
    y, x = np.nonzero(mask)
    room = y.min(), x.min(), mask.shape[0] - 1 - y.max(), mask.shape[1] - 1 - x.max()
    top, left, bottom, right = (int(random.uniform(0, 0.6) * max(space - 4, 0)) for space in room)
    window = slice(top, mask.shape[0] - bottom), slice(left, mask.shape[1] - right)
    return image[window], mask[window], landmarks.moved((float(left), float(top)), 1.0)


def _annotation(made: _Simulated, number: int) -> dict:
    y, x = np.nonzero(made.mask)
    box = [int(x.min()), int(y.min()), int(x.max() - x.min() + 1), int(y.max() - y.min() + 1)]
    flat = np.concatenate([[False], made.mask.T.ravel(), [False]])
    ends = np.flatnonzero(flat[1:] != flat[:-1])
    counts = np.diff(np.concatenate([[0], ends, [made.mask.size]])).tolist()
    points, depth, visibility = np.zeros((33, 2)), np.zeros(33), np.zeros(33)
    points[list(BLAZEPOSE)], visibility[list(BLAZEPOSE)] = made.landmarks.xy, made.landmarks.visibility
    if made.landmarks.depth is not None:
        depth[list(BLAZEPOSE)] = -made.landmarks.depth
    blazepose = {
        "xy": points.ravel().round(2).tolist(),
        "visibility": visibility.tolist(),
        "z": depth.round(2).tolist(),
    }
    size = list(made.mask.shape)
    record = {"id": number, "image_id": number, "bbox": box, "iscrowd": 0, "blazepose": blazepose}
    return record | {"segmentation": {"size": size, "counts": counts}}
