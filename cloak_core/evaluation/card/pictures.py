"""The worst of what an assessment saw, chosen by rule, as pictures beside the card."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from cloak_core.detectors.scoring import max_person_score, person_boxes
from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.experiments.lab import Lab, Trained
from cloak_core.evaluation.inference import bare_indices
from cloak_core.evaluation.measurement import Measurement
from cloak_core.evaluation.pictures import label, shoot, shoot_pair, to_pil
from cloak_core.evaluation.stage import Stage
from cloak_core.files.writing import written
from cloak_core.scene.pictures import save_picture

SHOWN = 4
"""Pictures of a kind."""
Shown = Mapping[str, tuple[Trained, tuple[float, ...], dict]]
"""By part: a cloak, the test azimuths and the settings it was judged with."""


@torch.no_grad()
def keep_pictures(folder: Path, lab: Lab, shown: Shown, card: dict) -> dict:
    """Write pictures into `folder` (replacing what is there) and return what they show, ready for JSON.

    `missed`: own clothing, the lowest scores not above the detector's own threshold; `hidden`: per part of the attack,
    cloaked bodies that it does not report though it is surest of them in own clothing; `alarms`: bare scenes with the
    surest false alarms; `cloaks`: the cloaks themselves, from the front and from behind.
    """
    shutil.rmtree(folder, ignore_errors=True)
    with written(folder):
        folder.mkdir(parents=True)
    own, detectors = card["operating_point"], lab.materials.detectors
    found: dict = {"missed": [], "alarms": [], "hidden": {}, "cloaks": []}
    for part, (worn, angles, settings) in shown.items():
        made = lab.evaluate_settings(**settings)
        stage = lab.stage(worn, angles, made)
        measured = lab.evaluate([worn], angles, **settings).measurements[0]
        place = folder / place_of(part)
        place.mkdir()
        if part == "clean":
            for trial in _missed(measured, own):
                found["missed"].append(label(stage, trial) | shoot(place, stage, trial, (CLOTHING,), detectors, own))
            bare = bare_indices(stage, made)
            alarms = sorted(((float(s), int(i)) for s, i in zip(measured.bare[0], bare, strict=True)), reverse=True)
            found["alarms"] = [_bare(place, stage, i, lab, own) for s, i in alarms[:SHOWN] if s > own]
        else:
            trials = hidden_trials(measured, own)
            found["hidden"][part] = [shoot_pair(place, stage, t, detectors, own) for t in trials]
            found["cloaks"].append({"part": part} | _cloak(place, stage))
    return found


def _missed(measured: Measurement, own: float) -> list[int]:
    score = measured.score[0, measured.controls.index(CLOTHING)]
    return [int(i) for i in np.argsort(score, kind="stable")[:SHOWN] if score[i] <= own]


def hidden_trials(measured: Measurement, own: float) -> list[int]:
    """Of the images that a cloak hides, those in which the detector is surest of the body in own clothing; each of
    another body, as far as there are some."""
    clean = measured.score[0, measured.controls.index(CLOTHING)]
    gone = np.flatnonzero((measured.score[0, 0] <= own) & (clean > own))
    order = gone[np.argsort(-clean[gone], kind="stable")]
    _, first = np.unique(measured.trials.pose[order], return_index=True)
    chosen = [*np.sort(first), *np.setdiff1d(np.arange(len(order)), first)]
    return [int(order[k]) for k in chosen[:SHOWN]]


def _bare(place: Path, stage: Stage, index: int, lab: Lab, own: float) -> dict:
    """A bare scene with the persons that the detector sees in it, told as `shoot` tells."""
    image, name = stage.bare([index])[0], f"bare-{index:05d}.jpg"
    save_picture(place / name, to_pil(image), quality=92, subsampling=0)
    boxes, scores = {}, {}
    for spec, detector in lab.materials.detectors.items():
        seen = detector(image[None])
        scores[spec] = round(float(max_person_score(seen)[0]), 4)
        boxes[spec] = [[round(v, 4) for v in row] for row in person_boxes(seen, own)[0].tolist()]
    return {"background": stage.background_names[index], "bare": {"file": name, "boxes": boxes, "scores": scores}}


def _cloak(place: Path, stage: Stage) -> dict[str, str]:
    """Front and back of the first body in the cloak, evenly lit and cut out."""
    files = {}
    for side, azimuth in (("front", 0.0), ("back", 180.0)):
        rgba = stage.flat_view(azimuth, side=320)
        files[side] = f"flat-{side}.png"
        picture = Image.fromarray((rgba * 255).round().byte().cpu().numpy(), "RGBA")
        save_picture(place / files[side], picture, optimize=True)
    return files


def first_part(parts: Sequence[str], hidden: Mapping[str, list]) -> str | None:
    """The first of these parts whose cloak hid anybody."""
    return next((part for part in parts if hidden.get(part)), None)


def place_of(part: str) -> str:
    """The folder of a part's pictures."""
    return part.replace(" ", "-").replace("%", "")
