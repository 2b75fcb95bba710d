"""How wide a picture hides best as cloth, chosen on people and detectors that do not judge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.evaluation.measure import OnProgress, measure
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.evaluation.statistics import finite, operating_point, share
from cloak_core.core.source import Cast
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.studies.opening import clothes_cover, open_pattern
from cloak_core.studies.trained_run import trained_against

AUTO = "@tile=auto"
WIDTHS = (0.1, 0.15, 0.2, 0.25, 0.35, 0.5, 0.7, 1.0)
"""Metres that are tried."""


def choose_widths(
    colors: Sequence[str],
    people: Cast,
    detectors: Mapping[str, Detector],
    judging: tuple[Crowd, Mapping[str, Detector]],
    backgrounds: Backgrounds,
    settings: WearSettings,
    on_progress: OnProgress | None = None,
    logo: str | None = None,
) -> tuple[list[str], dict[str, dict]]:
    """Replace each `@tile=auto` of COLORS by the width that hides most.

    people, detectors: whom the choice is made on. judging: the people and detectors that judge afterwards. Returns
    COLORS, and what `width_curve` measured for each of those that asked.
    InputError: a width is to be chosen, but on nobody, or on somebody who judges.
    """
    asked = [color for color in colors if AUTO in color]
    if not asked:
        return list(colors), {}
    for option, given in (("--width-people", people), ("--width-detector", detectors)):
        if not given:
            raise InputError(f"{asked[0]}: needs {option}, on whom the width is chosen, and who does not judge")
    _check_strangers(people, detectors, *judging)
    curves = {color: width_curve(color, people, detectors, backgrounds, settings, on_progress, logo) for color in asked}
    at_width = lambda color: color.replace(AUTO, f"@tile={curves[color]['chosen']:g}")
    return [at_width(color) if color in curves else color for color in colors], curves


def width_curve(
    color: str,
    people: Crowd,
    detectors: Mapping[str, Detector],
    backgrounds: Backgrounds,
    settings: WearSettings,
    on_progress: OnProgress | None = None,
    logo: str | None = None,
) -> dict:
    """Judge a picture, PICTURE@tile=auto, at each of `WIDTHS`, on shirt and trousers or `logo` (`clothes_cover`).

    Returns "detectors" {SPEC: {METRES: {"success", "success_own"}}}, "people", "photographs", and "chosen": the width
    in metres with the largest mean of both rates over the detectors, the narrower one of equals.
    """
    opened = [open_pattern(color.replace(AUTO, f"@tile={metres:g}"))[0] for metres in WIDTHS]
    patterns = {f"{metres:g}": worn.on(clothes_cover(logo)) for metres, worn in zip(WIDTHS, opened, strict=True)}
    images = people.images(backgrounds, settings, next(iter(detectors.values())).device)
    results = measure(images, patterns, detectors, batch=settings.batch, on_progress=on_progress)

    def hidden(spec: str, metres: str) -> dict[str, float | None]:
        rows = results.rows(spec, metres)
        thresholds = {"success": settings.threshold, "success_own": operating_point(rows)}
        return {name: None if at is None else finite(share(rows, at)) for name, at in thresholds.items()}

    rates = {spec: {metres: hidden(spec, metres) for metres in patterns} for spec in detectors}
    measured = [[one[metres][name] for one in rates.values() for name in one[metres]] for metres in patterns]
    means = [np.mean([rate for rate in of_width if rate is not None]) for of_width in measured]
    chosen = WIDTHS[int(np.argmax(means))]
    return {"chosen": chosen, "people": len(people), "photographs": len(people.people.photographs), "detectors": rates}


def _check_strangers(
    people: Crowd, detectors: Mapping[str, Detector], judges: Crowd, judging: Mapping[str, Detector]
) -> None:
    """Refuse people (by their photographs) and detectors (by their weights) that also judge. InputError."""
    judged = {person.identity for person in judges.people}
    both = set(people.pictures()) & set(judges.pictures())
    both |= {person.photograph for person in people.people if person.identity in judged}
    if both:
        raise InputError(f"--width-people: {min(both)} judges as well (take the other half: PEOPLE.json[0::2])")
    judge = trained_against({"detectors": list(map(detector_record, judging.values()))}, detectors)
    if any(judge.values()):
        raise InputError(f"--width-detector: {next(spec for spec in judge if judge[spec])} judges as well")
