"""Shows every image to every detector and keeps what they say."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from cloak_core.detectors import IOU
from cloak_core.detectors.protocol import Detections, Detector
from cloak_core.detectors.scoring import box_iou, max_person_score, person_boxes
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.measurement import Boxes, Measurement
from cloak_core.evaluation.precision import MOST_BOXES, first_hits
from cloak_core.evaluation.settings import EvaluateSettings
from cloak_core.evaluation.stage import Stage

BOX_THRESHOLD = 0.001
"""Boxes scored lower are not kept. Detectors are commonly scored so in COCO: a cloak that only makes a detector unsure
then still leaves it its average precision."""
OnProgress = Callable[[int, int], None]
"""Told after every batch: images done, images in all."""


@torch.no_grad()
def measure(
    stage: Stage, detectors: dict[str, Detector], settings: EvaluateSettings, on_progress: OnProgress | None = None
) -> Measurement:
    """Render every trial under the trained colours and every control, and keep what each detector says."""
    controls = all_controls(settings)
    bare = bare_indices(stage, settings)
    progress = Progress(len(stage.trials) * len(controls) + len(bare), on_progress)
    judges = list(detectors.values())
    score, score_on, boxes = _judge_trials(stage, judges, controls, settings.batch, progress)
    return Measurement(
        specs=tuple(detectors),
        controls=controls,
        body_names=tuple(stage.bodies.names),
        background_names=tuple(stage.background_names),
        trials=stage.trials,
        score=score,
        score_on=score_on,
        bare=_judge_bare(stage, judges, bare, settings.batch, progress),
        boxes=boxes,
    )


def all_controls(settings: EvaluateSettings) -> tuple[str, ...]:
    """The trained colours and what they are compared with; own clothing always is."""
    return tuple(dict.fromkeys((LOGO, CLOTHING, *settings.controls)))


class Progress:
    """Counts images, and tells."""

    def __init__(self, total: int, on_progress: OnProgress | None) -> None:
        self.done, self.total, self.on_progress = 0, total, on_progress

    def advance(self, images: int) -> None:
        self.done += images
        if self.on_progress:
            self.on_progress(self.done, self.total)


def _judge_trials(
    stage: Stage, detectors: Sequence[Detector], controls: Sequence[str], size: int, progress: Progress
) -> tuple[Float32[np.ndarray, "D C N"], Float32[np.ndarray, "D C N"], Boxes]:
    """A measurement's `score`, `score_on` and `boxes`, `size` images at once."""
    score = np.zeros((len(detectors), len(controls), len(stage.trials)), np.float32)
    score_on, found = np.zeros_like(score), []
    for batch in batches(np.arange(len(stage.trials)), size):
        views = stage.views(batch)
        true = stage.boxes(views, batch)
        for c, images in enumerate(stage.compose(views, batch, controls)):
            for d, detector in enumerate(detectors):
                detections = detector(images)
                score[d, c, batch] = max_person_score(detections).cpu().numpy()
                score_on[d, c, batch] = max_score_on(detections, true).cpu().numpy()
                found += _found(d, c, batch, detections, true.cpu())
            progress.advance(len(batch))
    kinds = (np.int64, np.int64, np.int64, np.float32, np.bool_, np.float64)
    columns = (
        np.concatenate(column).astype(kind) for column, kind in zip(zip(*found, strict=True), kinds, strict=True)
    )
    return score, score_on, Boxes(*columns)


def _judge_bare(
    stage: Stage, detectors: Sequence[Detector], backgrounds: np.ndarray, size: int, progress: Progress
) -> Float32[np.ndarray, "D M"]:
    """A measurement's `bare`."""
    score = []
    for batch in batches(backgrounds, size):
        images = stage.bare(batch)
        score.append([max_person_score(detector(images)).cpu().numpy() for detector in detectors])
        progress.advance(len(batch))
    return np.concatenate(score, axis=1).astype(np.float32)


def bare_indices(stage: Stage, settings: EvaluateSettings) -> np.ndarray:
    """[M] backgrounds for the false alarms: all of them, or a seeded draw where there are more than `bare`."""
    count = len(stage.background_names)
    order = np.random.default_rng([settings.seed, 0xBA2E]).permutation(count)
    return np.sort(order[: settings.bare])


def batches(indices: np.ndarray, size: int) -> Iterator[np.ndarray]:
    """`indices` in pieces of `size`."""
    for start in range(0, len(indices), size):
        yield indices[start : start + size]


def max_score_on(detections: Detections, boxes: Tensor, iou: float = IOU) -> Tensor:
    """[B] best score among the boxes that overlap the image's true box with at least `iou`, 0 where none does."""
    on = box_iou(detections.boxes, boxes[:, None].to(detections.boxes)) >= iou
    scores = torch.where(on, detections.scores, 0.0)
    return scores.max(1).values if scores.shape[1] else scores.sum(1)


def _found(
    detector: int, control: int, batch: np.ndarray, detections: Detections, true: Tensor
) -> Iterator[tuple[np.ndarray, ...]]:
    """The columns of `Boxes` for each image of a batch: person boxes after non-maximum suppression; `true` [B, 4]."""
    for image, boxes, truth in zip(batch, person_boxes(detections, BOX_THRESHOLD), true, strict=True):
        boxes = boxes[:MOST_BOXES]  # best first
        # In double precision: whether an overlap is 0.55 or just below shall not hang on rounding.
        iou = box_iou(boxes[:, :4].double(), truth.double()).numpy()
        hit = first_hits(iou, np.zeros(len(boxes), np.int64), IOU)
        label = np.broadcast_to(np.array([[detector], [control], [int(image)]]), (3, len(boxes)))
        yield (*label, boxes[:, 4].numpy(), hit, iou)
