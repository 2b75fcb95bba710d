"""`cloak evaluate RUN --people`: a run's colours judged on people in photographs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation.controls import LOGO
from cloak_core.evaluation.measure import OnProgress
from cloak_core.evaluation.wearing.clothes import read_clothes
from cloak_core.evaluation.wearing.settings import WearSettings
from cloak_core.evaluation.wearing.wearing import wear_and_judge
from cloak_core.files.errors import InputError
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.photographs.people import People


def evaluate_on_people(
    run: Path,
    config: dict,
    people: People,
    detectors: Mapping[str, Detector],
    backgrounds: Backgrounds,
    out: Path,
    settings: WearSettings | None = None,
    on_progress: OnProgress | None = None,
) -> dict:
    """Judge a run's colours on people in photographs, beside controls, into the new folder `out`.

    Returns what `cloak evaluate RUN --people --json` prints: contract C6's object with S for "logo" and the controls;
    "unseen": whether training saw none of the photographs; "white_box": which detectors it was trained against.
    """
    if out.exists():
        raise InputError(f"{out}: exists already (--out names another folder)")
    clothes = replace(read_clothes(str(run)), name=LOGO)
    trained = (config.get("people") or {}).get("photographs", [])
    known = {record["spec"] for record in config["detectors"]}
    more = {
        "unseen": {"photographs": not np.isin(people.photographs, trained).any()},
        "white_box": {spec: spec in known for spec in detectors},
    }
    return wear_and_judge([clothes], people, detectors, backgrounds, out, settings, on_progress, more)
