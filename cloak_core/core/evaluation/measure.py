"""Show every image of an evaluation to every detector, and keep what they say as a table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from cloak_core.core.detector import IOU, THRESHOLD
from cloak_core.core.detector.outcomes import OnBody, class_name, classes_above, without_classes
from cloak_core.core.detector.protocol import Detections, Detector, state_hash
from cloak_core.core.detector.scoring import box_iou, max_person_score, person_boxes
from cloak_core.core.evaluation import CLOTHING
from cloak_core.core.evaluation.precision import MOST_BOXES, first_hits
from cloak_core.core.evaluation.results import BOX_COLUMNS, CORNERS, TRUE_BOX, Results, make_results
from cloak_core.core.images import ImageSet, Indices
from cloak_core.core.pattern import Pattern
from cloak_core.files.errors import InputError

BOX_THRESHOLD = 0.001
"""Boxes with a lower score are not kept. COCO evaluations commonly use it: a cloak that only makes a detector unsure
then still leaves it its average precision."""
OnProgress = Callable[[int, int], None]
"""Called after every batch with the images done and the images in all."""
OnImages = Callable[[str, np.ndarray, Tensor, pd.DataFrame], None]
"""Called with a control, trials, their images, and the boxes found in them (columns as in `Results.boxes`)."""


@torch.no_grad()
def measure(
    images: ImageSet,
    patterns: Mapping[str, Pattern],
    detectors: Mapping[str, Detector],
    bare: Indices = (),
    *,
    batch: int = 16,
    on_progress: OnProgress | None = None,
    on_images: OnImages | None = None,
) -> Results:
    """Render every trial in every pattern and record what each detector reports.

    patterns: by name; the first is what is judged, the others are its controls. bare: backgrounds looked at with nobody
    in front. batch: images at once. The boxes of the result have corners.
    """
    judges = list(detectors.values())
    total, done = len(images.trials) * len(patterns) + len(bare), 0

    def advance(count: int) -> None:
        nonlocal done
        done += count
        if on_progress:
            on_progress(done, total)

    scores, boxes, true = _judge_trials(images, patterns, judges, batch, advance, on_images)
    return make_results(
        {spec: float(detector.operating_point) for spec, detector in detectors.items()},
        tuple(patterns),
        images.trials.assign(**dict(zip(TRUE_BOX, true.T, strict=True))),
        bare=_judge_bare(images, judges, np.asarray(bare, np.int64), batch, advance),
        boxes=boxes,
        **scores,
        body_names=images.body_names,
        background_names=images.background_names,
        bare_background=np.asarray(bare, np.int64),
    )


@contextmanager
def kept_frozen(detectors: Mapping[str, Detector]) -> Iterator[dict[str, str]]:
    """Yield the detectors' hashes by spec; afterwards check that nothing has changed them."""
    hashes = {spec: state_hash(detector) for spec, detector in detectors.items()}
    yield hashes
    for spec, detector in detectors.items():
        detector.verify(hashes[spec])


def check_asked(detectors: Mapping[str, Detector], angles: Sequence[float] | None = None) -> None:
    """Refuse an evaluation without a detector, or without an angle where there are angles (InputError)."""
    for option, named in (("--detector", detectors), ("--angles", (0.0,) if angles is None else angles)):
        if not len(named):
            raise InputError(f"{option}: none given")


def batches(indices: np.ndarray, size: int) -> Iterator[np.ndarray]:
    """Cut `indices` into pieces of `size`."""
    for start in range(0, len(indices), size):
        yield indices[start : start + size]


def _judge_trials(
    images: ImageSet,
    patterns: Mapping[str, Pattern],
    detectors: Sequence[Detector],
    size: int,
    advance: Callable[[int], None],
    on_images: OnImages | None,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], Float32[np.ndarray, "N 4"]]:
    """Judge all trials, `size` images at once: scores [D, C, N] by column of the results, found boxes, true boxes.

    Own clothing comes first: another class that is reported there already is nothing that a cloak brought.
    """
    names, count = list(patterns), len(images.trials)
    shape = len(detectors), len(names), count
    scores = {name: np.full(shape, np.nan, np.float32) for name in ("score", "score_on", "other")}
    scores["other_name"] = np.full(shape, "", object)
    true_boxes = np.zeros((count, 4), np.float32)
    box_rows = []
    order = sorted(range(len(names)), key=lambda c: names[c] != CLOTHING)
    for batch in batches(np.arange(count), size):
        views = images.views(batch, patterns[names[0]])
        true = images.boxes(views, batch)
        true_boxes[batch] = true.cpu().numpy()
        own: dict[int, list[Tensor] | None] = {}
        shown = images.compose(batch, [patterns[names[c]] for c in order])
        for c, pictures in zip(order, shown, strict=True):
            before = len(box_rows)
            for d, detector in enumerate(detectors):
                detections, best = images.judged(detector(pictures), views, batch)
                best = without_classes(best, detections, own.get(d))
                if names[c] == CLOTHING:
                    own[d] = classes_above(best, detections, min(float(detector.operating_point), THRESHOLD))
                for name, values in image_scores(detector, detections, best).items():
                    scores[name][d, c, batch] = values
                box_rows += _boxes(d, c, batch, detections, true.cpu())
            if on_images:
                on_images(names[c], batch, pictures, pd.DataFrame(_columns(box_rows[before:])))
            advance(len(batch))
    return scores, _columns(box_rows), true_boxes


def _columns(box_rows: Sequence[tuple[np.ndarray, ...]]) -> dict[str, np.ndarray]:
    """Join the boxes of images to the columns of `Results.boxes`."""
    names = (*BOX_COLUMNS, *CORNERS)
    columns = zip(*box_rows, strict=True) if box_rows else [[np.zeros(0)] for _ in names]
    return {name: np.concatenate(parts) for name, parts in zip(names, columns, strict=True)}


def image_scores(detector: Detector, detections: Detections, best: OnBody) -> dict[str, np.ndarray]:
    """Tell what is reported in each of B images, as columns of the results: score, score_on, other, other_name.

    best: what is reported on each person. The last two columns are missing where the detector does not tell of other
    classes.
    """
    columns = {"score": max_person_score(detections).cpu().numpy(), "score_on": best.person.cpu().numpy()}
    if best.other is not None:
        other = best.other.cpu().numpy()
        numbers = best.other_class.tolist()
        names = [class_name(detector.class_names, k) if s > 0 else "" for s, k in zip(other, numbers, strict=True)]
        columns |= {"other": other, "other_name": np.array(names, object)}
    return columns


def _judge_bare(
    images: ImageSet, detectors: Sequence[Detector], backgrounds: np.ndarray, size: int, advance: Callable[[int], None]
) -> Float32[np.ndarray, "D M"]:
    """Find the best scores on backgrounds without a person."""
    score = [np.zeros((len(detectors), 0), np.float32)]
    for batch in batches(backgrounds, size):
        shown = images.bare(batch)
        score.append(np.stack([max_person_score(detector(shown)).cpu().numpy() for detector in detectors]))
        advance(len(batch))
    return np.concatenate(score, axis=1).astype(np.float32)


def _boxes(
    detector: int, control: int, batch: np.ndarray, detections: Detections, true: Float[Tensor, "B 4"]
) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield columns of `Results.boxes` for each image of a batch: person boxes after non-maximum suppression."""
    for image, boxes, truth in zip(batch, person_boxes(detections, BOX_THRESHOLD), true, strict=True):
        boxes = boxes[:MOST_BOXES]  # best first
        # In double precision: whether an overlap is 0.55 or just below shall not hang on rounding.
        iou = box_iou(boxes[:, :4].double(), truth.double()).numpy()
        hit = first_hits(iou, np.zeros(len(boxes), np.int64), IOU)
        label = np.broadcast_to(np.array([[detector], [control], [int(image)]]), (3, len(boxes)))
        yield (*label, boxes[:, 4].numpy(), hit, iou, *boxes[:, :4].numpy().T)
