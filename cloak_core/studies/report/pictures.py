"""Draw pictures of an evaluation.

Rules decide which images are shown, before anyone has seen a score, or by the scores alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from matplotlib import font_manager
from PIL import Image, ImageFont
from torch import Tensor

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.detector.scoring import max_person_score, person_boxes
from cloak_core.core.evaluation import CLOTHING, LOGO
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.statistics import success_rate, undetected
from cloak_core.core.evaluation.trials import complete
from cloak_core.core.images import ImageSet
from cloak_core.core.pattern import Pattern
from cloak_core.core.pictures import save_picture

BODIES = 3
PEOPLE = 8
ANGLES = 5
FAILURES = 6
WORST = 10
SAVING = {"quality": 92, "subsampling": 0}
"""Pillow's options for JPEG."""
SOFT, PAPER = "#59636e", "#ffffff"
"""Colours of what stands beside names, and of the ground."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """Images of an evaluation to be drawn into a folder, and the detectors that look at the pictures."""

    folder: Path
    images: ImageSet
    patterns: Mapping[str, Pattern]
    detectors: Mapping[str, Detector]

    def pair(self, trial: int) -> dict:
        """Write one trial in own clothing and cloaked; return what the pictures show and what is found in them."""
        return describe(self.images, trial) | self.shots(trial, (CLOTHING, LOGO))

    @torch.no_grad()
    def shots(self, trial: int, names: Iterable[str]) -> dict[str, dict]:
        """Write one trial in these patterns; return by pattern what `write_shot` does, of the trial's person alone."""
        patterns = {name: self.patterns[name] for name in names}
        views = self.images.views([trial], next(iter(patterns.values())))
        judged = lambda answer: self.images.judged(answer, views, [trial])[0]
        return {
            name: write_shot(self.folder / f"{trial:05d}-{name}.jpg", image, self.detectors, judged)
            for name, image in zip(patterns, self.images.compose([trial], list(patterns.values())), strict=True)
        }


def write_pictures(drawing: Drawing, results: Results) -> dict:
    """Write an evaluation's pictures (JPEG) and return what they show, ready for JSON.

    `thresholds`: each detector's own, by which all of these go; `gallery`: the images of `gallery_trials`, in own
    clothing and cloaked; `failures`: per detector, the cloaked images with the highest scores above it; `worst`: per
    detector, of the bodies that the cloak hides least often the image with the highest score, and its success;
    `controls`: one image in every pattern.
    """
    images, pair = drawing.images, drawing.pair
    trials = complete(images.trials)
    shown = gallery_trials(trials)
    middle = shown[len(shown) // (2 * trials.loc[shown, "pose"].nunique())]
    thresholds = {spec: float(detector.operating_point) for spec, detector in drawing.detectors.items()}
    failures, worst = {}, {}
    for spec, threshold in thresholds.items():
        rows = results.rows(spec, LOGO)
        surest = first_by(rows[~undetected(rows, threshold)], FAILURES)["image"].tolist()
        failures[spec] = [pair(trial) for trial in surest]
        worst[spec] = [pair(trial) | {"success": rate} for trial, rate in worst_trials(rows, threshold)]
    return {
        "thresholds": thresholds,
        "gallery": [pair(trial) for trial in shown],
        "failures": failures,
        "worst": worst,
        "controls": describe(images, middle) | {"images": drawing.shots(middle, drawing.patterns)},
    }


def gallery_trials(trials: pd.DataFrame) -> list[int]:
    """Choose the first image of up to 3 bodies (evenly spaced) at up to 5 angles (likewise), in that order.

    Without angles, of up to 8 people. Of a body without an image at an angle (few images were asked for) the one
    nearest to it, once.
    """
    pose, angle = trials["pose"].to_numpy(), np.nan_to_num(trials["angle"].to_numpy())
    angles = _spaced(np.unique(angle), ANGLES)
    bodies = PEOPLE if trials["angle"].isna().all() else BODIES
    images = [np.flatnonzero(pose == p) for p in _spaced(np.unique(pose), bodies)]
    return list(dict.fromkeys(int(own[np.abs(angle[own] - a).argmin()]) for own in images for a in angles))


def _spaced(values: np.ndarray, count: int) -> np.ndarray:
    """Choose at most `count` of the values, evenly spaced."""
    return values[np.linspace(0, len(values) - 1, min(count, len(values))).round().astype(int)]


def first_by(rows: pd.DataFrame, count: int, by: Sequence[str] = ("score",), ascending: bool = False) -> pd.DataFrame:
    """Select the rows with the highest scores, or the lowest, in this order; equals in the order of images."""
    return rows.sort_values([*by], ascending=ascending, kind="stable").head(count)


def worst_trials(rows: pd.DataFrame, threshold: float) -> list[tuple[int, float]]:
    """Choose the image with the highest score of the ten bodies with the lowest success below 1; also that success.

    The worst first, equals by their mean score.
    """
    worst = []
    for _, group in rows.groupby("pose"):
        score = group["score"].to_numpy()
        worst.append(
            (success_rate(group, threshold), -float(score.mean()), int(group["image"].to_numpy()[score.argmax()]))
        )
    return [(trial, success) for success, _, trial in sorted(worst)[:WORST] if success < 1]


def describe(images: ImageSet | Results, trial: int) -> dict:
    """Say what one trial shows, as plain values; None for what its view does not have."""
    row = images.trials.loc[trial]
    angle, distance = (None if pd.isna(row.get(name)) else float(row[name]) for name in ("angle", "distance"))
    named = lambda names, name: names[int(row[name])] if 0 <= row.get(name, -1) < len(names) else None
    return {
        "trial": int(trial),
        "body": named(images.body_names, "pose"),
        "angle": angle,
        "distance": None if distance is None else round(distance, 4),
        "background": named(images.background_names, "background"),
    }


def write_shot(
    path: Path,
    image: Float[Tensor, "1 3 H W"],
    detectors: Mapping[str, Detector],
    judged: Callable[[Detections], Detections] = lambda answer: answer,
) -> dict:
    """Write one image as JPEG; return its `file` and what is `reported` in it, above each detector's own threshold."""
    save_picture(path, to_pil(image[0]), **SAVING)
    return {"file": path.name} | reported(image, detectors, judged=judged)


@torch.no_grad()
def reported(
    image: Float[Tensor, "1 3 H W"],
    detectors: Mapping[str, Detector],
    threshold: float | None = None,
    judged: Callable[[Detections], Detections] = lambda answer: answer,
) -> dict:
    """Tell each detector's `boxes` above the threshold (x1, y1, x2, y2, score, best first) and its best `scores`.

    threshold: None for each detector's own. judged: takes what counts of an answer.
    """
    boxes, scores = {}, {}
    for spec, detector in detectors.items():
        answer = judged(detector(image))
        above = float(detector.operating_point) if threshold is None else threshold
        scores[spec] = round(float(max_person_score(answer)[0]), 4)
        boxes[spec] = [[round(v, 4) for v in row] for row in person_boxes(answer, above)[0].tolist()]
    return {"boxes": boxes, "scores": scores}


def write_flat(folder: Path, side: str, rgba: Float[Tensor, "h w 4"]) -> str:
    """Write a flat view as PNG and return its file name."""
    name = f"flat-{side}.png"
    save_picture(folder / name, Image.fromarray((rgba * 255).round().byte().cpu().numpy(), "RGBA"), optimize=True)
    return name


def to_pil(image: Float[Tensor, "3 H W"]) -> Image.Image:
    """Convert an image in [0, 1] to a picture."""
    return Image.fromarray((image.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).cpu().numpy())


def font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Load the plots' font, which comes with matplotlib."""
    properties = font_manager.FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")
    return ImageFont.truetype(font_manager.findfont(properties), size)
