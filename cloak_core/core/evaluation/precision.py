"""Compute COCO's average precision for images that show one body each.

The same numbers as `pycocotools.cocoeval.COCOeval` (bbox, one class, no crowds, all areas), which a test holds to 1e-6;
written anew because it is asked for at every angle and body of an evaluation, which COCOeval takes far longer for, and
because measurements keep overlaps and no boxes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int64

from cloak_core.core.detector import IOU
from cloak_core.core.evaluation.results import Results

MOST_BOXES = 100
"""Boxes of an image that count, best first, as in COCO."""
OVERLAPS = tuple(round(0.5 + 0.05 * k, 2) for k in range(10))
"""0.5, 0.55 ... 0.95: what AP50:95 is the mean over."""
_RECALLS = np.linspace(0, 1, 101)


def average_precision(results: Results, rows: pd.DataFrame, overlaps: Sequence[float] = (IOU,)) -> float:
    """Compute COCO's average precision of these images: AP50, or the mean over `overlaps` (`OVERLAPS`: AP50:95).

    rows: of one detector and control; the mean over several trainings. nan without images, and for other overlaps than
    0.5 where an earlier version measured.
    """
    boxes = results.boxes_of(rows)
    values = []
    for training, own_rows in rows.groupby("training"):
        own = boxes[(boxes["training"] == training).to_numpy()]
        score, iou, image, hit = (own[name].to_numpy() for name in ("score", "iou", "image", "hit"))
        if np.isnan(iou).any() and set(overlaps) != {IOU}:
            return math.nan
        hits = (hit if overlap == IOU else first_hits(iou, image, overlap) for overlap in overlaps)
        values.append(np.mean([average_precision_of(is_hit, score, len(own_rows)) for is_hit in hits]))
    return float(np.mean(values)) if values else math.nan


def first_hits(iou: Float[np.ndarray, " N"], image: Int64[np.ndarray, " N"], overlap: float) -> Bool[np.ndarray, " N"]:
    """Mark each image's first box that overlaps its body with at least `overlap`; an image's boxes come best first."""
    on = np.flatnonzero(iou >= overlap)
    hit = np.zeros(len(iou), bool)
    hit[on[np.unique(image[on], return_index=True)[1]]] = True
    return hit


def average_precision_of(hit: Bool[np.ndarray, " N"], score: Float[np.ndarray, " N"], bodies: int) -> float:
    """Compute the mean, over 101 recalls (0, 0.01 ... 1), of the best precision at this recall or a higher one.

    hit: which boxes are true positives; every other one is a false positive. Boxes of equal score keep their order.
    bodies: how many there were to find; nan for none.
    """
    if not bodies:
        return math.nan
    true = np.cumsum(hit[np.argsort(-score, kind="stable")]).astype(float)
    precision = true / np.arange(1, len(true) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    at = np.searchsorted(true / bodies, _RECALLS, side="left")
    return float(np.append(envelope, 0.0)[at].mean())
