"""Dress people in photographs and judge them in one call."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluation.measure import OnProgress
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.surroundings import plain_torch
from cloak_core.detectors.loading import Given
from cloak_core.library.values import Figures, Named, by_name, cast_of, made_settings, open_backgrounds
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.photographs.people import People
from cloak_core.studies.wearing.wearing import choose_widths, wear_and_judge


@plain_torch()
def wear(
    colors: Named | Sequence[Named],
    people: People | Named,
    detectors: Mapping[str, Given] | Given | Sequence[Given],
    backgrounds: Backgrounds | Named = "procedural:test",
    *,
    images: Named | None = None,
    logo: str | None = None,
    out: Named | None = None,
    settings: WearSettings | None = None,
    device: str = "cpu",
    on_progress: OnProgress | None = None,
    width_people: People | Named | None = None,
    width_detectors: Mapping[str, Detector] | Sequence[Detector | str] = (),
    **changes: object,
) -> Figures:
    """Dress people in photographs in trained colours or pictures, and judge them beside controls.

    colors: each a run folder, zoo:NAME, PICTURE@tile=METRES or PICTURE@patch=METRES; PICTURE: a file, print:NAME, or a
    run of cloth. people: what `load_people` gave, or a COCO file (its photographs in `images`). logo: regions or a face
    list that cloths, pictures and controls cover (None: a run's own, else shirt and trousers). backgrounds: without
    people, for false alarms. out: a new folder for pictures and tables. How to judge: `settings`, or `changes` of the
    defaults by the names of `cloak wear`'s options. `on_progress` hears (images done, images in all). width_people,
    width_detectors: on whom PICTURE@tile=auto chooses its width; they may not judge.

    Returns what `cloak wear --json` prints: for each detector success of every colours and control with intervals over
    people and photographs, how many people, who was left out and why. InputError names what cannot be read or worn.
    """
    settings = made_settings(settings, changes, WearSettings)
    named = [os.fspath(color) for color in ([colors] if isinstance(colors, str | os.PathLike) else colors)]
    scenes = open_backgrounds(backgrounds)
    judging = (cast_of(people, images), by_name(detectors, device))
    choosing = cast_of(width_people, images)
    choosers = by_name(width_detectors, device) if len(width_detectors) else {}
    colors, widths = choose_widths(named, choosing, choosers, judging, scenes, settings, on_progress, logo)
    more = {"widths": widths} if widths else None
    folder = None if out is None else Path(out)
    return Figures(wear_and_judge(colors, *judging, scenes, folder, settings, on_progress, more, logo))
