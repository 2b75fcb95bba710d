"""A made person in a made photograph, with everything about her known: no photograph of anybody is in the tests."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from cloak_core.core.cameras import Camera
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.people.skeleton import about
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.sources.photographs.annotation import BLAZEPOSE, INDEX, NAMES
from cloak_core.sources.photographs.posing import Posed
from cloak_core.sources.photographs.rig import SEGMENTS, Rig, body_rig

SIZE = (300, 260)
"""Height and width of the photograph."""
SCALE = 140.0
"""Pixels per metre: a person of 260 pixels."""
CENTRE = np.array([130.0, -150.0])
SEGMENT_OF = {
    "shoulder": "chest",
    "hip": "pelvis",
    "elbow": "arm",
    "wrist": "forearm",
    "knee": "thigh",
    "ankle": "shin",
}


def standing(azimuth: float = 0.0, swing: float = 0.0) -> Posed:
    """The rig upright, arms down, turned; `swing`: degrees that the legs part, one forwards, one backwards."""
    rig = body_rig()
    whole = about("y", azimuth)
    transforms = np.zeros((len(SEGMENTS), 3, 4))
    for number, name in enumerate(SEGMENTS):
        side, _, part = name.rpartition("_")
        pivot, turn = np.zeros(3), np.eye(3)
        out = 1.0 if side == "l" else -1.0
        if part in ("arm", "forearm", "hand"):
            pivot, turn = rig.joints[f"{side}_shoulder"], about("z", -30.0 * out)
        elif part in ("thigh", "shin", "foot"):
            pivot, turn = rig.joints[f"{side}_hip"], about("x", swing * out)
        matrix = whole @ turn * SCALE
        place = whole @ pivot * SCALE - matrix @ pivot
        transforms[number, :, :3], transforms[number, :, 3] = matrix, place + np.append(CENTRE, 0.0)
    return Posed(transforms, SCALE)


def landmarks_of(posed: Posed, rig: Rig) -> np.ndarray:
    """[21, 3]: x, y (down) and depth in the order of `NAMES`."""
    at = np.zeros((len(NAMES), 3))
    for name, number in INDEX.items():
        side, _, joint = name.rpartition("_")
        if joint in SEGMENT_OF:
            segment = SEGMENT_OF[joint]
            at[number] = posed.joint(rig, name, segment if segment in SEGMENTS else f"{side}_{segment}")
        else:
            at[number] = posed.joint(rig, "head", "head")
    at[:, 1] *= -1
    return at


def rasterized(posed: Posed, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Mask [h, w] and the rig's triangle at each pixel (-1: none), by a far camera."""
    height, width = SIZE
    distance = 40.0 * height
    vertices = posed.vertices(rig)
    centre = np.array([width / 2, -height / 2])
    vertices[:, :2] = centre + (vertices[:, :2] - centre) * (1 - vertices[:, 2:] / distance)
    field = float(2 * np.degrees(np.arctan(height / 2 / distance)))
    camera = Camera(distance, 0.0, 0.0, field, width, height, pivot=(*map(float, centre), 0.0))
    bodies = Bodies(vertices[None].astype(np.float32), rig.triangles.astype(np.int32))
    view = ViewCache(bodies, RenderSettings(samples=1, light=Light(1.0, 0.0, 0.0))).view(0, camera)
    triangle = np.full(height * width, -1)
    triangle[view.pixels.numpy()] = view.map.column.numpy()[view.map.crow.numpy()[:-1]]
    return triangle.reshape(SIZE) >= 0, triangle.reshape(SIZE)


def run_lengths(mask: np.ndarray) -> list[int]:
    """COCO's uncompressed run lengths: by column, zeros first."""
    flat = np.concatenate([[False], mask.T.ravel(), [False]])
    ends = np.flatnonzero(flat[1:] != flat[:-1])
    counts = np.diff(np.concatenate([[0], ends])).tolist()
    return [*counts, mask.size - int(np.sum(counts))] if np.sum(counts) < mask.size else counts


def annotation(posed: Posed, number: int = 1, image: int = 1, kind: str = "blazepose") -> tuple[dict, np.ndarray]:
    """One annotation as a file has it, and the triangles that are truly seen."""
    rig = body_rig()
    mask, triangle = rasterized(posed, rig)
    y, x = np.nonzero(mask)
    box = [int(x.min()), int(y.min()), int(x.max() - x.min() + 1), int(y.max() - y.min() + 1)]
    record = {"id": number, "image_id": image, "category_id": 1, "iscrowd": 0, "bbox": box}
    record["segmentation"] = {"size": list(SIZE), "counts": run_lengths(mask)}
    at = landmarks_of(posed, rig)
    if kind == "blazepose":
        xy, depth = np.zeros((33, 2)), np.zeros(33)
        xy[list(BLAZEPOSE)], depth[list(BLAZEPOSE)] = at[:, :2], -at[:, 2]
        seen = np.ones(33)
        seen[[19, 20, 29, 30, 31, 32]] = 0.0  # nobody said where hands and feet point
        record["blazepose"] = {"xy": xy.ravel().tolist(), "z": depth.tolist(), "visibility": seen.tolist()}
    else:
        points = np.zeros((17, 3))
        points[[0, 3, 4, *range(5, 17)]] = np.concatenate([at[:15, :2], np.full((15, 1), 2.0)], axis=1)
        record["keypoints"] = points.ravel().tolist()
    return record, triangle


def photograph(mask: np.ndarray | None = None, seed: int = 0) -> Image.Image:
    """A made photograph: soft noise, and someone flat and bright in it."""
    random = np.random.default_rng(seed)
    image = np.array(Image.fromarray(random.integers(60, 160, (12, 10, 3), np.uint8)).resize(SIZE[::-1]))
    if mask is not None:
        image[mask] = (180, 170, 150)
    return Image.fromarray(image)


def write_people(folder: Path, count: int = 2, kind: str = "blazepose", **changes: object) -> Path:
    """PEOPLE.json with `count` photographs of a person each, seen from here and there; `changes` of each annotation."""
    folder.mkdir(parents=True, exist_ok=True)
    images, annotations = [], []
    for number in range(count):
        record, triangle = annotation(standing(azimuth=25.0 * number), number + 1, number + 1, kind)
        photograph(triangle >= 0, number).save(folder / f"made{number}.png")
        images.append({"id": number + 1, "file_name": f"made{number}.png", "width": SIZE[1], "height": SIZE[0]})
        annotations.append(record | changes)
    path = folder / "people.json"
    path.write_text(json.dumps({"images": images, "annotations": annotations}))
    return path


def edit(path: Path, change: Callable[[dict], object]) -> Path:
    """Change the record of a people file."""
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))
    return path
