"""Average precision is that of pycocotools, on boxes that tie, pile up and lie on the very edge of an overlap."""

import contextlib
import io

import numpy as np
import pytest
import torch
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from cloak_core.core.detector.scoring import box_iou
from cloak_core.core.evaluation.precision import OVERLAPS, average_precision, first_hits
from cloak_core.core.evaluation.results import make_results
from cloak_core.core.evaluation.trials import make_trials

IMAGES = 60


def drawn(seed: int, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """True boxes [N, 4] and found boxes [K, 4] (xyxy) with their image and score; whole pixels and few scores, so that
    both overlaps and scores tie; the surest first in every image."""
    rng = np.random.default_rng(seed)
    corner = rng.integers(0, 20, (IMAGES, 2))
    true = np.concatenate([corner, corner + rng.integers(10, 30, (IMAGES, 2))], 1).astype(float)
    image = np.repeat(np.arange(IMAGES), rng.integers(0, most, IMAGES))
    near = np.round(true[image] + rng.choice([0, 0, 1, 2, 5, 12], (len(image), 4)) * rng.choice([-1, 1]))
    near[:, 2:] = np.maximum(near[:, 2:], near[:, :2] + 1)
    score = rng.choice([0.1, 0.25, 0.5, 0.75, 0.9], len(image)).astype(np.float32)
    order = np.lexsort((-score, image))
    return true, near[order], image[order], score[order]


def coco(true: np.ndarray, found: np.ndarray, image: np.ndarray, score: np.ndarray) -> tuple[float, float]:
    """AP50 and AP50:95, as pycocotools says."""
    sized = lambda box: [*map(float, box[:2]), *map(float, box[2:] - box[:2])]
    truth = COCO()
    with contextlib.redirect_stdout(io.StringIO()):
        truth.dataset = {
            "images": [{"id": i} for i in range(IMAGES)],
            "categories": [{"id": 1, "name": "person"}],
            "annotations": [
                {"id": i + 1, "image_id": i, "category_id": 1, "iscrowd": 0, "bbox": sized(b), "area": 100.0}
                for i, b in enumerate(true)
            ],
        }
        truth.createIndex()
        boxes = [
            {"image_id": int(i), "category_id": 1, "bbox": sized(b), "score": float(s)}
            for b, i, s in zip(found, image, score, strict=True)
        ]
        judge = COCOeval(truth, truth.loadRes(boxes), "bbox")
        judge.evaluate()
        judge.accumulate()
        judge.summarize()
    return float(judge.stats[1]), float(judge.stats[0])


@pytest.mark.parametrize(("seed", "most"), [(0, 2), (1, 5), (2, 9), (3, 9), (4, 130)])
def test_it_is_what_pycocotools_says(seed: int, most: int) -> None:
    true, found, image, score = drawn(seed, most)
    iou = box_iou(torch.from_numpy(found), torch.from_numpy(true[image])).numpy()
    assert most < 9 or any(np.isclose(iou, t, atol=1e-12).any() for t in OVERLAPS)  # on the very edge, too
    # The surest hundred of an image, as measuring keeps them.
    kept = np.arange(len(image)) - np.searchsorted(image, image) < 100
    iou, image_kept, zeros = iou[kept], image[kept], np.zeros(int(kept.sum()), np.int64)
    found_in = {"detector": zeros, "control": zeros, "image": image_kept}
    boxes = found_in | {"score": score[kept], "hit": first_hits(iou, image_kept, 0.5), "iou": iou}
    trials = make_trials(np.zeros(IMAGES), np.zeros(IMAGES), 6, 2.2, np.zeros(IMAGES), np.zeros((IMAGES, 2)))
    scores, names = np.zeros((1, 1, IMAGES), np.float32), {"body_names": ["a"], "background_names": ["b"]}
    bare = np.zeros((1, 0), np.float32)
    results = make_results({"one": None}, ("logo",), trials, scores, scores, bare, boxes, **names)
    ap50, ap = coco(true, found, image, score)
    rows = results.rows("one", "logo")
    assert average_precision(results, rows) == pytest.approx(ap50, abs=1e-6)
    assert average_precision(results, rows, overlaps=OVERLAPS) == pytest.approx(ap, abs=1e-6)
    assert 0 < ap < ap50 < 1
