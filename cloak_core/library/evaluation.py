"""Measure what a run's colours are worth in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cloak_core.core.evaluation.measure import OnProgress
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings.values import Angles, from_plain
from cloak_core.core.surroundings import plain_torch
from cloak_core.detectors.loading import Given
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.profiles import read_profile
from cloak_core.files.errors import InputError
from cloak_core.library.values import Figures, Named, by_name, cast_of, made_settings, open_backgrounds, open_bodies
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.studies import evaluate as study
from cloak_core.studies.opening import find_run, open_run, printed, snapshot_pattern
from cloak_core.studies.trained_run import kept_back, trained_specs

if TYPE_CHECKING:
    from cloak_core.core.training import RunResult
    from cloak_core.sources.photographs.people import People


@plain_torch()
def evaluate(
    run: RunResult | Named,
    scene: Bodies | Named | None = None,
    backgrounds: Backgrounds | Named | None = None,
    detectors: Mapping[str, Given] | Given | Sequence[Given] | None = None,
    *,
    colors: Named | None = None,
    logo: Named | None = None,
    profile: Named | None = None,
    out: Named | None = None,
    over_time: bool = False,
    people: People | Named | None = None,
    angles: Sequence[float] | str = "-10:10:1",
    settings: EvaluateSettings | None = None,
    device: str = "cpu",
    on_progress: OnProgress | None = None,
    **changes: object,
) -> Figures:
    """Measure what a run's colours are worth, beside controls on the same images, into RUN/evaluation or `out`.

    run: a run folder, what `train` returned, or zoo:NAME. colors: judge these on the run's logo instead: a .npy of
    colours [L, 3], a picture on the scene's UV map, PICTURE@tile=METRES (on people PICTURE@patch=METRES, too), another
    run, or zoo:NAME; then into RUN/evaluation-NAME. logo: regions or a face list that a cloth or picture covers instead
    of the run's logo; its name ends the folder's. profile:
    of a printer and a camera (`cloak calibrate`): judge the colours as they come out of `cloak print --profile`; then
    into RUN/evaluation-printed. over_time:
    judge the snapshots that training kept, too ("over_time" of the result, and RUN/curve.json and .png; on people
    RUN/curve-people.json and .png). An evaluation of the same content in its folder is not made again.
    scene, backgrounds: given as they are or by name; None takes what was kept back of the embedded material that
    training saw. detectors: given as they are (in a mapping, by the names they get in the result), or by spec, then
    loaded on `device`; None: the run's own detectors, unless one runs code. people: in photographs (`load_people`, or a
    COCO file): judge on these instead of renders, into RUN/evaluation-people, all else alike; `settings` then decide
    size, threshold, controls, bare, resamples, batch and seed. angles: azimuths in degrees. How to evaluate:
    `settings`, or `changes` of the defaults by the names of `cloak evaluate`'s options (`images_per_view=2`).
    `on_progress` hears (images done, images in all), in the calling thread.

    Returns what `cloak evaluate --json` prints, as a dict with a `to_frame()`: success under the logo and each control,
    in [0, 1], per detector and by angle and body, with 95 % intervals; whether bodies and backgrounds were unseen;
    false alarms. InputError: no finished run, a scene of another topology, nothing to evaluate on.
    """
    settings = made_settings(settings, changes, EvaluateSettings)
    folder, config = find_run(run)
    if over_time and (profile is not None or settings.cycles is not None):
        raise InputError(
            "--over-time: judges snapshots as they are, in our own renders: without --profile and --cycles"
        )
    judges = by_name(trained_specs(folder, config) if detectors is None else detectors, device)
    if people is None:
        bodies = open_bodies(scene or kept_back("scene", config))
        behind = open_backgrounds(backgrounds or kept_back("backgrounds", config))
        angles = from_plain("angles", angles, Angles) if isinstance(angles, str) else angles
        judged = study.OnBodies(bodies, behind, angles)
    else:
        if scene is not None or settings.cycles is not None:
            raise InputError("--people: photographs are what is judged on: without --scene and --cycles")
        judged = study.OnPeople(cast_of(people), open_backgrounds(backgrounds or "procedural:test"))
    pattern, trained, name = open_run(folder, config, colors, judged.bodies, logo)
    parts = [judged.folder, name, "printed" if profile is not None else "", settings.cycles or ""]
    target = folder / "-".join(part for part in parts if part) if out is None else Path(out)

    def judge(worn: Pattern, how: EvaluateSettings, training: dict | None, out: Path | None) -> dict:
        what = judged.show(worn, judges, how, training)
        return study.evaluate(what, judges, how, out=out, on_progress=on_progress)

    worn = pattern if profile is None else printed(pattern, read_profile(profile))
    summary = judge(worn, settings, trained, target) | judged.record(target)
    if over_time:
        summary["over_time"] = study.over_time(
            folder,
            lambda path, bare: judge(snapshot_pattern(folder, path, pattern.cover), bare, None, None),
            settings,
            judged.curve,
        )
    return Figures(summary)
