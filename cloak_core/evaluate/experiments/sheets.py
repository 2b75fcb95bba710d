"""Contact sheets of an experiment: cloaked bodies with the boxes a detector draws, and its failures.

Which images are shown is decided by rule (see `pictures.py`), before anyone has seen a score.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluate.contact_sheet import draw_sheet
from cloak_core.evaluate.controls import CLOTHING, LOGO
from cloak_core.evaluate.experiments.lab import Lab, Trained
from cloak_core.evaluate.experiments.repeats import Repeats
from cloak_core.evaluate.figures import SERIES
from cloak_core.evaluate.pictures import failure_trials, gallery_trials, shoot_pair

SIDE = 160
"""Of a picture, pixels."""


def contact_sheets(
    lab: Lab, spec: str, trained: Trained, result: Repeats, angles: tuple[float, ...]
) -> dict[str, Image.Image]:
    """Up to two sheets by name, "gallery" and "failures".

    The first shows unseen bodies in own clothing and cloaked; the second the cloaked images that score highest, where
    any is above the threshold. `result` is the evaluation of `trained` (of several seeds the first) at `angles`.
    """
    measurement = result.measurements[0]
    d = measurement.specs.index(spec)
    stage = lab.stage(trained, angles, lab.evaluate_settings())
    detectors = {spec: lab.materials.detectors[spec]}
    groups = {"gallery": gallery_trials(stage.trials), "failures": failure_trials(measurement, d, THRESHOLD)}
    sheets = {}
    with TemporaryDirectory() as folder:
        for name, trials in groups.items():
            shots = [shoot_pair(Path(folder), stage, trial, detectors, THRESHOLD) for trial in trials]
            if shots:
                sheets[name] = draw_sheet(Path(folder), spec, *_layout(name, shots), SIDE)
    return sheets


def _layout(name: str, shots: list[dict]) -> tuple[list[str], list[tuple[str, list[dict]]]]:
    """Column heads and rows of a sheet."""
    angle = lambda shot: f"{shot['angle']:g}°".replace("-", "\N{MINUS SIGN}")
    both = (CLOTHING, LOGO)
    if name == "failures":
        heads = [f"{shot['body'][:12]}, {angle(shot)}" for shot in shots]
        return heads, [(SERIES[c].label, [shot[c] for shot in shots]) for c in both]
    bodies = list(dict.fromkeys(shot["body"] for shot in shots))
    mine = {body: [shot for shot in shots if shot["body"] == body] for body in bodies}
    heads = [angle(shot) for shot in mine[bodies[0]]]
    return heads, [(SERIES[c].label, [shot[c] for shot in mine[body]]) for body in bodies for c in both]
