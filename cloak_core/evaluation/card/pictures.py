"""The worst of what an assessment saw, chosen by rule, as pictures beside the card."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.report.pictures import describe, draw_pair, draw_trial, first_by, write_flat, write_shot
from cloak_core.evaluation.results import NOBODY
from cloak_core.evaluation.statistics import hidden
from cloak_core.evaluation.store import RunStore, Trained
from cloak_core.files.writing import written

SHOWN = 4
"""Pictures of a kind."""
SIDES = {"front": 0.0, "back": 180.0}
Shown = Mapping[str, tuple[Trained, tuple[float, ...], dict]]
"""By part: a cloak, the test azimuths and the evaluation settings it was judged with."""


def keep_pictures(folder: Path, store: RunStore, shown: Shown, card: dict) -> dict:
    """Write pictures into `folder` (replacing what is there) and return what they show, ready for JSON.

    `missed`: own clothing, the lowest scores not above the detector's own threshold; `hidden`: per part of the attack,
    cloaked bodies that it does not report though it is surest of them in own clothing; `alarms`: bare scenes with the
    surest false alarms; `cloaks`: the cloaks themselves, from the front and from behind.
    """
    shutil.rmtree(folder, ignore_errors=True)
    with written(folder):
        folder.mkdir(parents=True)
    spec, own, detectors = card["spec"], card["operating_point"], store.split.detectors
    found: dict = {"missed": [], "alarms": [], "hidden": {}, "cloaks": []}
    for part, (worn, angles, settings) in shown.items():
        renderer = store.renderer(worn, angles, store.evaluate_settings(**settings))
        results = store.evaluate([worn], angles, **settings)
        place = folder / place_of(part)
        place.mkdir()
        if part == "clean":
            rows, bare = results.rows(spec, CLOTHING), results.rows(spec, NOBODY)
            for trial in first_by(rows[hidden(rows, own)], SHOWN, ascending=True)["image"].tolist():
                shots = draw_trial(place, renderer, trial, (CLOTHING,), detectors, own)
                found["missed"].append(describe(renderer, trial) | shots)
            for index in first_by(bare[~hidden(bare, own)], SHOWN, ("score", "background"))["background"].tolist():
                shot = write_shot(place / f"bare-{index:05d}.jpg", renderer.bare([index]), detectors, own)
                found["alarms"].append({"background": renderer.background_names[index], "bare": shot})
        else:
            trials = hidden_trials(results.rows(spec, LOGO), own)
            found["hidden"][part] = [draw_pair(place, renderer, trial, detectors, own) for trial in trials]
            flat = {side: write_flat(place, side, renderer.flat_view(angle, 320)) for side, angle in SIDES.items()}
            found["cloaks"].append({"part": part} | flat)
    return found


def hidden_trials(rows: pd.DataFrame, own: float) -> list[int]:
    """Choose the hidden images whose person is found most surely in own clothing, of different bodies if possible."""
    gone = rows[hidden(rows, own) & (rows["clean"] > own).to_numpy()]
    gone = gone.sort_values("clean", ascending=False, kind="stable")
    repeated = gone["pose"].duplicated()
    return [*gone["image"][~repeated], *gone["image"][repeated]][:SHOWN]


def place_of(part: str) -> str:
    """Name the folder of a part's pictures."""
    return part.replace(" ", "-").replace("%", "")
