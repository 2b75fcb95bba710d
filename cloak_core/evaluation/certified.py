"""Measure the people whom one small patch cannot hide: certified recall of a detector behind masks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.detectors import THRESHOLD
from cloak_core.detectors.defended.masks import Masks
from cloak_core.detectors.protocol import Detections, Detector
from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.measure import batches
from cloak_core.evaluation.renderer import EvaluationRenderer
from cloak_core.evaluation.wearing.judging import PeopleRenderer
from cloak_core.evaluation.wearing.settings import WearSettings
from cloak_core.render.photographs.fits import fit_people
from cloak_core.scene.backdrops.backgrounds import load_backgrounds
from cloak_core.scene.photographs.people import People

BATCH = 8


@torch.no_grad()
def check_people(detector: Detector, people: People, *, threshold: float = THRESHOLD) -> dict:
    """Measure recall on people in photographs as they are, in the crops of `cloak wear`.

    Returns {"clean_recall": share with a box on them above `threshold`, "clean_recall_own", "operating_point",
    "operating_point_assumed", "n": people}, and `certified_recall`.
    """
    renderer = PeopleRenderer(fit_people(people), (), load_backgrounds("procedural:test:1"), WearSettings())
    found = on_body_scores(renderer, lambda images: [detector(images)])
    return {
        "clean_recall": float((found > threshold).double().mean()),
        "clean_recall_own": float((found > detector.operating_point).double().mean()),
        "operating_point": detector.operating_point,
        "operating_point_assumed": detector.operating_point_assumed,
        "n": len(people),
    } | certified_recall(detector, renderer, threshold)


def certified_recall(detector: Detector, renderer: EvaluationRenderer, threshold: float) -> dict:
    """Certify the people of a renderer against one patch (`detectors.defended.masks`).

    Returns {"certified_recall": share of images in which the answer under every mask has a box on the person above
    `threshold`, "certified_recall_own", "patch": side in pixels}; {} for a detector that is not `masked=...`.
    """
    masks = getattr(detector, "defence", None)
    if not isinstance(masks, Masks):
        return {}
    floor = on_body_scores(renderer, partial(masks.answers, detector.inner))
    kept = [float((floor > t).double().mean()) for t in (threshold, detector.operating_point)]
    return {"certified_recall": kept[0], "certified_recall_own": kept[1], "patch": masks.patch}


def on_body_scores(
    renderer: EvaluationRenderer, answers: Callable[[Tensor], Iterable[Detections]]
) -> Float[Tensor, " N"]:
    """Find the best score on each person in own clothing; the least over several answers."""
    scores = []
    for batch in batches(np.arange(len(renderer.trials)), BATCH):
        views = renderer.views(batch)
        (images,) = renderer.compose(views, batch, (CLOTHING,))
        told = [renderer.about_person(found, views, batch) for found in answers(images)]
        scores.append(torch.stack([renderer.on_person(found, views, batch).person for found in told]).amin(0))
    return torch.cat(scores).cpu()
