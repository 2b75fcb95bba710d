"""Renders with their boxes and masks as a data set in COCO's format: every image in own clothing, and cloaked.

Keys that COCO knows mean what they mean there; what else is known of a render stands beside them: an image's `camera`,
`background`, `pair` and `cloaked`, an annotation's `bbox_full` and `attributes`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool

from cloak_core import __version__
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.inference import OnProgress, batches
from cloak_core.evaluation.pictures import to_pil
from cloak_core.evaluation.stage import Stage
from cloak_core.files.errors import InputError
from cloak_core.files.writing import new_folder, write_json
from cloak_core.render.images.dressing import DressedView
from cloak_core.render.visibility.projection import GRID
from cloak_core.scene.pictures import save_picture

ANNOTATIONS = "annotations.json"
IMAGES = "images"
PERSON = 1
"""COCO's category."""
BATCH = 16
DRESSES = {CLOTHING: False, LOGO: True}
"""What an image may show, and whether that is cloaked; in the order of a pair's two images."""


@torch.no_grad()
def export_coco(
    stage: Stage, out: Path, kind: Literal["jpg", "png"] = "jpg", on_progress: OnProgress | None = None
) -> dict:
    """Write every trial twice into the new folder `out`: `images/` and `annotations.json`. Returns counts.

    InputError: the folder exists and is not empty.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: exists already")
    images, annotations = [], []
    with new_folder(out) as folder:
        (folder / IMAGES).mkdir()
        for batch in batches(np.arange(len(stage.trials)), BATCH):
            views = stage.views(batch)
            for cloaked, pictures in zip(DRESSES.values(), stage.compose(views, batch, tuple(DRESSES)), strict=True):
                for trial, view, picture in zip(batch, views, pictures, strict=True):
                    image = _image(stage, int(trial), cloaked, kind)
                    save_picture(folder / IMAGES / image["file_name"], to_pil(picture), **_quality(kind))
                    images.append(image)
                    annotations += _annotations(stage, int(trial), view, image)
            if on_progress:
                on_progress(len(images), 2 * len(stage.trials))
        for number, annotation in enumerate(annotations, 1):
            annotation["id"] = number
        write_json(folder / ANNOTATIONS, _header() | {"images": images, "annotations": annotations})
    counts = {"images": len(images), "annotations": len(annotations), "cloaked": len(stage.trials)}
    return {"out": str(out), "file": str(out / ANNOTATIONS)} | counts


def _quality(kind: str) -> dict:
    """Pillow's options: JPEG hardly changes what a detector sees then."""
    return {"quality": 95, "subsampling": 0} if kind == "jpg" else {"optimize": True}


def _header() -> dict:
    info = {"description": "renders of bodies in their own clothing and cloaked", "version": f"cloak {__version__}"}
    category = {"id": PERSON, "name": "person", "supercategory": "person"}
    return {"info": info, "licenses": [], "categories": [category]}


def _image(stage: Stage, trial: int, cloaked: bool, kind: str) -> dict:
    camera, trials = stage.camera(trial), stage.trials
    where = {"distance": camera.distance, "azimuth": camera.azimuth, "elevation": camera.elevation}
    return {
        "id": 2 * trial + cloaked + 1,
        "file_name": f"{trial:06d}-{'cloaked' if cloaked else 'clothing'}.{kind}",
        "width": camera.width,
        "height": camera.height,
        "pair": trial,
        "cloaked": cloaked,
        "camera": {name: round(float(value), 4) for name, value in where.items()}
        | {"field_of_view": float(camera.field_of_view)},
        "background": stage.background_names[int(trials.background[trial])],
    }


def _annotations(stage: Stage, trial: int, view: DressedView, image: dict) -> Iterator[dict]:
    """The body's annotation, without its id; none where nothing of it is in the image."""
    mask, trials = _mask(stage, trial, view), stage.trials
    if not mask.any():
        return
    rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    x, y = int(columns[0]), int(rows[0])
    box = [x, y, int(columns[-1]) - x + 1, int(rows[-1]) - y + 1]
    whole = _whole_box(stage, trial) or box
    yield {
        "image_id": image["id"],
        "category_id": PERSON,
        "iscrowd": 0,
        "bbox": box,
        "bbox_full": whole,
        "area": int(mask.sum()),
        "segmentation": {"size": [view.height, view.width], "counts": run_lengths(mask)},
        "attributes": {
            "cloaked": image["cloaked"],
            "body": stage.bodies.names[int(trials.pose[trial])],
            "pose": int(trials.pose[trial]),
            "outfit": int(trials.outfit[trial]),
            "visible": round(min(1.0, box[2] * box[3] / max(whole[2] * whole[3], 1e-9)), 4),
        },
    }


def _mask(stage: Stage, trial: int, view: DressedView) -> Bool[np.ndarray, "h w"]:
    """The pixels that the body covers by at least half, moved as the trial says."""
    pixels = view.pixels[view.coverage >= 0.5].cpu().numpy()
    dx, dy = map(int, stage.trials.shift[trial])
    y, x = pixels // view.width + dy, pixels % view.width + dx
    kept = (x >= 0) & (x < view.width) & (y >= 0) & (y < view.height)
    mask = np.zeros((view.height, view.width), bool)
    mask[y[kept], x[kept]] = True
    return mask


def _whole_box(stage: Stage, trial: int) -> list[float] | None:
    """[x, y, width, height] of the whole body, also beyond the image; None where some of it is behind the camera."""
    screen = stage.bank.screen([(int(stage.trials.pose[trial]), stage.camera(trial))])
    if screen.safe is not None and not bool(screen.safe.all()):
        return None
    dx, dy = map(float, stage.trials.shift[trial])
    x, y = screen.x[0].double() / GRID + dx, screen.y[0].double() / GRID + dy
    sides = (x.min(), y.min(), x.max() - x.min(), y.max() - y.min())
    return [round(float(value), 2) for value in sides]


def run_lengths(mask: Bool[np.ndarray, "h w"]) -> list[int]:
    """COCO's run lengths: how many pixels are out, in, out ... down column after column, beginning with out."""
    flat = mask.ravel(order="F")
    edges = np.flatnonzero(np.diff(flat)) + 1
    runs = np.diff(np.concatenate([[0], edges, [flat.size]])).tolist()
    return [0, *runs] if flat[0] else runs
