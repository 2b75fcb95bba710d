"""Training and evaluation as one call each: for notebooks and programs, and for the commands, which call the same.

Nothing of the process is changed: no number of threads, no seed, no logging, no signal handler that stays. Everything
may be called twice, and from any thread.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.events import OnEvent
from cloak_core.core.logo import Logo, load_logo
from cloak_core.core.settings import TrainSettings, make_settings
from cloak_core.core.settings.values import Angles, from_plain
from cloak_core.core.source import NOBODY, Cast
from cloak_core.core.surroundings import plain_torch
from cloak_core.core.training import RunResult
from cloak_core.detectors.naming import full_spec
from cloak_core.detectors.objects import Given, as_detector, as_detectors
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.profiles import read_profile
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.studies.figures import Figures
from cloak_core.studies.trained_run import kept_back, read_run, trained_specs
from cloak_core.studies.trainings.training import train as train_logo
from cloak_core.zoo.entry import run_path

if TYPE_CHECKING:
    from cloak_core.core.evaluation.measure import OnProgress
    from cloak_core.core.evaluation.settings import FilmSettings, WearSettings
    from cloak_core.core.pattern import Pattern
    from cloak_core.sources.photographs.people import People

T = TypeVar("T")
Named = str | os.PathLike
"""What the command line takes: a path, or a spec such as sample:train."""


@plain_torch()
def train(
    scene: Bodies | Named | None,
    logo: Logo | Named,
    detectors: Given | Sequence[Given] = ("builtin",),
    backgrounds: Backgrounds | Named = "procedural:train",
    *,
    out: Named,
    settings: TrainSettings | None = None,
    resume: bool = False,
    on_event: OnEvent | None = None,
    inputs: Mapping[str, str] | None = None,
    query_prior: Given | Sequence[Given] = (),
    people: People | Named | None = None,
    techniques: Sequence[str] = (),
    **changes: object,
) -> RunResult:
    """Train the logo's colours against the detectors, into the run folder `out`.

    scene, logo, detectors and backgrounds are given as they are or by name (one detector may stand for a list of one;
    a module of your own, a torchvision model or a function on pictures is one, see `as_detector`);
    names are recorded in the run's config.json, and `inputs` beside them. people: in photographs (`load_people`, or a
    COCO file), shown beside the scene's renders, or alone where `scene` is None (the logo is then one of the sample
    bodies). How to train: `settings`, or `changes` of a preset by the names of `cloak train`'s options
    (`preset="best", steps=100, angles="-10:10:5"`). `query_prior`: detectors whose gradients lead a search by
    questions. `techniques`: of other packages, NAME or NAME:TEXT. `on_event` hears every event that goes to
    events.jsonl, in the calling thread; where it returns True, the run ends after the step. So do SIGINT (in the main
    thread), a file `cancel` in `out` and the time budget, with a checkpoint; `resume` goes on from there to the
    result with the same bits, on the same device with the same number of threads.

    Returns how the run ended; its `colors` [L, 3] are sRGB in [0, 1], in the order of `logo.face_ids`. Raises
    InputError, naming it, for whatever cannot be read, does not fit together, or cannot be trained against; a run
    folder that exists and is not resumed is refused.
    """
    named = {"scene": scene, "logo": logo, "backgrounds": backgrounds, "people": people}
    cast = cast_of(people)
    if settings is None:
        changes = {"preset": cast.preset()} | changes
    settings = _either(settings, changes, make_settings)
    if scene is None:
        scene, settings = "sample:train", cast.alone(settings)
    bodies = _bodies(scene)
    return train_logo(
        settings,
        bodies,
        logo if isinstance(logo, Logo) else load_logo(bodies, logo),
        as_detectors(detectors, settings.compute.device),
        _backdrops(backgrounds),
        out,
        resume=resume,
        on_event=None if on_event is None else _stopping(on_event, Path(out)),
        inputs={key: str(value) for key, value in named.items() if isinstance(value, Named)} | dict(inputs or {}),
        query_prior=as_detectors(query_prior, settings.compute.device),
        people=cast,
        techniques=techniques,
    )


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
    loaded on `device`; None takes those that the run was trained against,
    unless one runs code. people: in photographs (`load_people`, or a
    COCO file): judge on these instead of renders, into RUN/evaluation-people, all else alike; `settings` then decide
    size, threshold, controls, bare, resamples, batch and seed. angles: azimuths in degrees. How to evaluate:
    `settings`, or `changes` of the defaults by the names of `cloak evaluate`'s options (`images_per_view=2`).
    `on_progress` hears (images done, images in all), in the calling thread.

    Returns what `cloak evaluate --json` prints, as a dict with a `to_frame()`: success under the logo and each control,
    in [0, 1], per detector and by angle and body, with 95 % intervals; whether bodies and backgrounds were unseen;
    false alarms. InputError: no finished run, a scene of another topology, nothing to evaluate on.
    """
    # They bring matplotlib, which training needs not.
    from cloak_core.studies import evaluate as study
    from cloak_core.studies.opening import open_run, printed, snapshot_pattern

    settings = _either(settings, changes, EvaluateSettings)
    folder, config = _opened(run)
    if over_time and (profile is not None or settings.cycles is not None):
        raise InputError(
            "--over-time: judges snapshots as they are, in our own renders: without --profile and --cycles"
        )
    judges = _by_name(trained_specs(folder, config) if detectors is None else detectors, device)
    if people is None:
        bodies = _bodies(scene or kept_back("scene", config))
        behind = _backdrops(backgrounds or kept_back("backgrounds", config))
        angles = from_plain("angles", angles, Angles) if isinstance(angles, str) else angles
        judged = study.OnBodies(bodies, behind, angles)
    else:
        if scene is not None or settings.cycles is not None:
            raise InputError("--people: photographs are what is judged on: without --scene and --cycles")
        judged = study.OnPeople(cast_of(people), _backdrops(backgrounds or "procedural:test"))
    pattern, trained, name = open_run(folder, config, colors, judged.bodies, logo)
    parts = [judged.folder, name, "printed" if profile is not None else "", settings.cycles or ""]
    target = folder / "-".join(part for part in parts if part) if out is None else Path(out)

    def judge(worn: Pattern, how: EvaluateSettings, training: dict | None, out: Path | None) -> dict:
        what = judged.show(worn, judges, how, training)
        return study.evaluate(what, judges, how, out=out, on_progress=on_progress)

    worn = pattern if profile is None else printed(pattern, read_profile(profile))
    summary = judge(worn, settings, trained, target) | judged.told(target)
    if over_time:
        summary["over_time"] = study.over_time(
            folder,
            lambda path, bare: judge(snapshot_pattern(folder, path, pattern.cover), bare, None, None),
            settings,
            judged.curve,
        )
    return Figures(summary)


def _backdrops(backgrounds: Backgrounds | Named) -> Backgrounds:
    return backgrounds if isinstance(backgrounds, Backgrounds) else load_backgrounds(backgrounds)


def cast_of(people: People | Named | None, images: Named | None = None) -> Cast:
    """Make what shows people in photographs: loaded ones, or those of a COCO file; None: nobody. InputError."""
    if people is None:
        return NOBODY
    # Whoever shows bodies alone needs nothing of photographs.
    from cloak_core.sources.photographs.crowd import Crowd
    from cloak_core.sources.photographs.people import load_people

    return Crowd(load_people(people, images) if isinstance(people, Named) else people)


def _bodies(scene: Bodies | Named) -> Bodies:
    return scene if isinstance(scene, Bodies) else load_scene(scene)


def _opened(run: RunResult | Named) -> tuple[Path, dict]:
    """Find a run's folder and read its record. InputError: no finished run."""
    folder = Path(run.out) if isinstance(run, RunResult) else run_path(run)
    return folder, read_run(folder)


@plain_torch()
def film(
    run: RunResult | Named,
    out: Named,
    scene: Bodies | Named | None = None,
    backgrounds: Backgrounds | Named | None = None,
    detectors: Mapping[str, Given] | Given | Sequence[Given] | None = None,
    *,
    colors: Named | None = None,
    logo: Named | None = None,
    settings: FilmSettings | None = None,
    device: str = "cpu",
    on_progress: OnProgress | None = None,
) -> dict:
    """Film a run's colours in motion beside the body's own clothing: NAME.mp4, NAME.gif, or a folder of PNGs.

    The scene's poses in their order are the motion; all else is as in `evaluate`. Returns what `cloak film --json`
    prints: frames hidden, the longest visible run, first sight, tracks; per detector for colours and clothing.
    InputError: as in `evaluate`; another kind of film, no PyAV for a .mp4.
    """
    from cloak_core.studies.film import make_film
    from cloak_core.studies.opening import open_run

    folder, config = _opened(run)
    bodies = _bodies(scene or kept_back("scene", config))
    pattern, _, _ = open_run(folder, config, colors, bodies, logo)
    behind = _backdrops(backgrounds or kept_back("backgrounds", config))
    judges = _by_name(trained_specs(folder, config) if detectors is None else detectors, device)
    return make_film(pattern, bodies, behind, judges, Path(out), settings, on_progress)


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
    from cloak_core.core.evaluation.settings import WearSettings
    from cloak_core.studies.wearing.wearing import wear_and_judge
    from cloak_core.studies.wearing.widths import choose_widths

    settings = _either(settings, changes, WearSettings)
    given = [os.fspath(color) for color in ([colors] if isinstance(colors, str | os.PathLike) else colors)]
    scenes = _backdrops(backgrounds)
    judging = (cast_of(people, images), _by_name(detectors, device))
    choosing = cast_of(width_people, images)
    choosers = _by_name(width_detectors, device) if len(width_detectors) else {}
    colors, widths = choose_widths(given, choosing, choosers, judging, scenes, settings, on_progress, logo)
    more = {"widths": widths} if widths else None
    folder = None if out is None else Path(out)
    return Figures(wear_and_judge(colors, *judging, scenes, folder, settings, on_progress, more, logo))


def _stopping(on_event: OnEvent, out: Path) -> OnEvent:
    """Have a listener that returns True end the run, as a file named `cancel` in its folder does."""

    def listener(event: dict) -> None:
        if on_event(event) is True:
            (out / "cancel").touch()

    return listener


def _either(settings: T | None, changes: dict, make: Callable[..., T]) -> T:
    """Take the settings, or make them by the changes. TypeError: both are given."""
    if settings is not None and changes:
        raise TypeError(f"settings are given: change {', '.join(changes)} there")
    return make(**changes) if settings is None else settings


def _by_name(detectors: Mapping[str, Given] | Given | Sequence[Given], device: str) -> dict[str, Detector]:
    """Make detectors of what is given, by the names in a mapping, else by their specs."""
    if isinstance(detectors, Mapping):
        return {name: as_detector(given, device) for name, given in detectors.items()}
    given = detectors if isinstance(detectors, (list, tuple)) else [detectors]
    made = as_detectors(given, device)
    return {full_spec(one) if isinstance(one, str) else d.spec: d for one, d in zip(given, made, strict=True)}
