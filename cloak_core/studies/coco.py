"""Write renders with their boxes and masks as a data set in COCO's format: in own clothing, and cloaked.

Keys that COCO knows mean what they mean there; what else is known of a render stands beside them: an image's `camera`,
`background`, `pair` and `cloaked`, an annotation's `bbox_full` and `attributes`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool

from cloak_core import __version__
from cloak_core.core.evaluation.measure import OnProgress, batches
from cloak_core.core.images import ImageSet
from cloak_core.core.paint import body_masks
from cloak_core.core.pattern import Pattern
from cloak_core.core.pictures import save_picture
from cloak_core.core.view import BakedView
from cloak_core.core.visibility.screen import GRID
from cloak_core.files.writing import new_folder, require_new, write_json
from cloak_core.patterns.controls import OwnClothing
from cloak_core.studies.imagery import camera_of
from cloak_core.studies.report.pictures import to_pil

ANNOTATIONS = "annotations.json"
IMAGES = "images"
PERSON = 1
"""COCO's category."""
BATCH = 16
SAVING = {"jpg": {"quality": 95, "subsampling": 0}, "png": {"optimize": True}}
"""Pillow's options: at this quality JPEG hardly changes what a detector reports."""


@torch.no_grad()
def export_coco(
    shown: ImageSet,
    pattern: Pattern,
    out: Path,
    kind: Literal["jpg", "png"] = "jpg",
    on_progress: OnProgress | None = None,
) -> dict:
    """Write every trial twice into the new folder `out`: `images/` and `annotations.json`. Returns counts.

    InputError: the folder exists and is not empty.
    """
    require_new(out)
    images, annotations = [], []
    with new_folder(out) as folder:
        (folder / IMAGES).mkdir()
        for batch in batches(np.arange(len(shown.trials)), BATCH):
            views = shown.views(batch, pattern)
            pair = shown.compose(batch, (OwnClothing(pattern.cover), pattern))
            for cloaked, pictures in zip((False, True), pair, strict=True):
                for trial, view, picture in zip(batch.tolist(), views, pictures, strict=True):
                    image = _image(shown, trial, cloaked, kind)
                    save_picture(folder / IMAGES / image["file_name"], to_pil(picture), **SAVING[kind])
                    images.append(image)
                    annotation = _annotation(shown, trial, view, image)
                    if annotation:
                        annotations.append({"id": len(annotations) + 1} | annotation)
            if on_progress:
                on_progress(len(images), 2 * len(shown.trials))
        info = {"description": "renders of bodies in their own clothing and cloaked", "version": f"cloak {__version__}"}
        category = {"id": PERSON, "name": "person", "supercategory": "person"}
        head = {"info": info, "licenses": [], "categories": [category]}
        write_json(folder / ANNOTATIONS, head | {"images": images, "annotations": annotations})
    counts = {"images": len(images), "annotations": len(annotations), "cloaked": len(shown.trials)}
    return {"out": str(out), "file": str(out / ANNOTATIONS)} | counts


def _image(shown: ImageSet, trial: int, cloaked: bool, kind: str) -> dict:
    trials = shown.trials
    camera = camera_of(shown, trial)
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
        "background": shown.background_names[trials.at[trial, "background"]],
    }


def _annotation(shown: ImageSet, trial: int, view: BakedView, image: dict) -> dict:
    """Make the body's annotation, without its id; {} where nothing of it is in the image."""
    mask = body_masks([view], shown.shifts([trial]))[0].cpu().numpy()
    trials = shown.trials
    if not mask.any():
        return {}
    rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    x, y = int(columns[0]), int(rows[0])
    box = [x, y, int(columns[-1]) - x + 1, int(rows[-1]) - y + 1]
    whole = _whole_box(shown, trial) or box
    return {
        "image_id": image["id"],
        "category_id": PERSON,
        "iscrowd": 0,
        "bbox": box,
        "bbox_full": whole,
        "area": int(mask.sum()),
        "segmentation": {"size": [view.height, view.width], "counts": run_lengths(mask)},
        "attributes": {
            "cloaked": image["cloaked"],
            "body": shown.body_names[trials.at[trial, "pose"]],
            "pose": int(trials.at[trial, "pose"]),
            "outfit": int(trials.at[trial, "outfit"]),
            "visible": round(min(1.0, box[2] * box[3] / max(whole[2] * whole[3], 1e-9)), 4),
        },
    }


def _whole_box(shown: ImageSet, trial: int) -> list[float] | None:
    """Compute [x, y, width, height] of the whole body, also beyond the image; None where it passes the camera."""
    views = shown.source.views_for(shown.source.on_cloth)
    screen = views.screen([(int(shown.trials.at[trial, "pose"]), camera_of(shown, trial))])
    if screen.in_guard_band is not None and not bool(screen.in_guard_band.all()):
        return None
    dx, dy = shown.shifts([trial])[0].tolist()
    x, y = screen.x[0].double() / GRID + dx, screen.y[0].double() / GRID + dy
    sides = (x.min(), y.min(), x.max() - x.min(), y.max() - y.min())
    return [round(float(value), 2) for value in sides]


def run_lengths(mask: Bool[np.ndarray, "h w"]) -> list[int]:
    """Encode a mask as COCO's run lengths: pixels out, in, out ... down column after column, beginning with out."""
    flat = mask.ravel(order="F")
    edges = np.flatnonzero(np.diff(flat)) + 1
    runs = np.diff(np.concatenate([[0], edges, [flat.size]])).tolist()
    return [0, *runs] if flat[0] else runs
