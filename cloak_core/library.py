"""Training and evaluation as one call each: for notebooks and programs, and for the commands, which call the same.

Nothing of the process is changed: no number of threads, no seed, no logging, no signal handler that stays. Everything
may be called twice, and from any thread.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.events import OnEvent
from cloak_core.core.logo import Logo, load_logo
from cloak_core.core.loop import RunResult
from cloak_core.core.settings import TrainSettings, make_settings
from cloak_core.core.settings.values import Angles, from_plain
from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.profiles import read_profile
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.photographs.people import People, load_people
from cloak_core.studies.trained_run import read_run
from cloak_core.studies.trainings.training import train as train_logo
from cloak_core.zoo.entry import run_path

if TYPE_CHECKING:
    from cloak_core.core.evaluation.measure import OnProgress
    from cloak_core.core.evaluation.settings import FilmSettings, WearSettings
    from cloak_core.sources.photographs.fitting import Fit

T = TypeVar("T")
_log = logging.getLogger("cloak")
Named = str | os.PathLike
"""What the command line takes: a path, or a spec such as sample:train."""


def train(
    scene: Bodies | Named | None,
    logo: Logo | Named,
    detectors: Detector | str | Sequence[Detector | str] = ("builtin",),
    backgrounds: Backgrounds | Named = "procedural:train",
    *,
    out: Named,
    settings: TrainSettings | None = None,
    resume: bool = False,
    on_event: OnEvent | None = None,
    inputs: Mapping[str, str] | None = None,
    query_prior: Detector | str | Sequence[Detector | str] = (),
    people: People | Named | None = None,
    **changes: object,
) -> RunResult:
    """Train the logo's colours against the detectors, into the run folder `out`.

    scene, logo, detectors and backgrounds are given as they are or by name (one detector may stand for a list of one);
    names are recorded in the run's config.json, and `inputs` beside them. people: in photographs (`load_people`, or a
    COCO file), shown beside the scene's renders, or alone where `scene` is None (the logo is then one of the sample
    bodies). How to train: `settings`, or `changes` of a preset by the names of `cloak train`'s options
    (`preset="best", steps=100, angles="-10:10:5"`). `query_prior`: detectors whose gradients lead a search by
    questions. `on_event` hears every event that goes to events.jsonl, in the calling thread. SIGINT (in the main
    thread), a file `cancel` in `out` or the time budget end it after the current step with a checkpoint; `resume` goes
    on from there to the bit-identical result.

    Returns how the run ended; its `colors` [L, 3] are sRGB in [0, 1], in the order of `logo.face_ids`. Raises
    InputError, naming it, for whatever cannot be read, does not fit together, or cannot be trained against; a run
    folder that exists and is not resumed is refused.
    """
    if people is not None and settings is None:
        changes.setdefault("preset", "photographs")
    settings = _either(settings, changes, make_settings)
    if people is None and scene is None:
        raise InputError("--scene: none given, and no --people")
    named = {"scene": scene, "logo": logo, "backgrounds": backgrounds, "people": people}
    fits = _fitted(people)
    if scene is None:
        scene, settings = "sample:train", settings.changed(people_share=1.0)
    bodies = scene if isinstance(scene, Bodies) else load_scene(scene)
    return train_logo(
        settings,
        bodies,
        logo if isinstance(logo, Logo) else load_logo(bodies, logo),
        [_detector(detector, settings.compute.device) for detector in _several(detectors)],
        backgrounds if isinstance(backgrounds, Backgrounds) else load_backgrounds(backgrounds),
        out,
        resume=resume,
        on_event=on_event,
        inputs={key: str(value) for key, value in named.items() if isinstance(value, Named)} | dict(inputs or {}),
        query_prior=[_detector(detector, settings.compute.device) for detector in _several(query_prior)],
        people=fits,
    )


def evaluate(
    run: RunResult | Named,
    scene: Bodies | Named | None = None,
    backgrounds: Backgrounds | Named | None = None,
    detectors: Mapping[str, Detector] | Detector | str | Sequence[Detector | str] | None = None,
    *,
    colors: Named | None = None,
    profile: Named | None = None,
    out: Named | None = None,
    over_time: bool = False,
    people: People | Named | None = None,
    angles: Sequence[float] | str = "-10:10:1",
    settings: EvaluateSettings | None = None,
    device: str = "cpu",
    on_progress: OnProgress | None = None,
    **changes: object,
) -> dict:
    """Measure what a run's colours are worth, beside controls on the same images, into RUN/evaluation or `out`.

    run: a run folder, what `train` returned, or zoo:NAME. colors: judge these on the run's logo instead: a .npy of
    colours [L, 3], a picture on the scene's UV map, another run, or zoo:NAME; then into RUN/evaluation-NAME. profile:
    of a printer and a camera (`cloak calibrate`): judge the colours as they come out of `cloak print --profile`; then
    into RUN/evaluation-printed. over_time:
    judge the snapshots that training kept, too ("over_time" of the result, and RUN/curve.json and .png).
    scene, backgrounds: given as they are or by name; None takes what was kept back of the embedded material that
    training saw. detectors: given as they are (in a mapping, by the names they get in the result), or by spec, then
    loaded on `device`; None takes those that the run was trained against. people: in photographs (`load_people`, or a
    COCO file): judge on these instead of renders, into RUN/evaluation-people; `settings` then decide threshold, size
    and batch alone. angles: azimuths in degrees. How to evaluate: `settings`, or `changes` of the defaults by the names
    of `cloak evaluate`'s options (`images_per_view=2`).
    `on_progress` hears (images done, images in all), in the calling thread.

    Returns what `cloak evaluate --json` prints: success under the logo and each control, in [0, 1], per detector and by
    angle and body, with 95 % intervals; whether bodies and backgrounds were unseen; false alarms. InputError: no
    finished run, a scene of another topology, nothing to evaluate on.
    """
    from cloak_core.studies.cloaked import open_cloaked
    from cloak_core.studies.evaluate import FOLDER
    from cloak_core.studies.evaluate import evaluate as evaluate_logo  # brings matplotlib, which training needs not
    from cloak_core.studies.evaluate import over_time as judge_snapshots

    settings = _either(settings, changes, EvaluateSettings)
    folder = Path(run.out) if isinstance(run, RunResult) else run_path(run)
    config = read_run(folder)
    if people is not None:
        if (scene, colors, profile) != (None, None, None) or over_time:
            raise InputError("--people: judges the run's own colours: without --scene, --colors and the like")
        specs = [trained["spec"] for trained in config["detectors"]] if detectors is None else detectors
        place = folder / "evaluation-people" if out is None else Path(out)
        return _on_people(folder, config, people, _by_name(specs, device), backgrounds, place, settings, on_progress)
    cloaked, trained, name = open_cloaked(folder, config, scene, backgrounds, colors)
    place = f"{FOLDER}-{name}" if name else FOLDER
    if over_time and (profile is not None or settings.cycles is not None):
        raise InputError(
            "--over-time: judges snapshots as they are, in our own renders: without --profile and --cycles"
        )
    if profile is not None:
        printer = read_profile(profile)
        cloaked = replace(cloaked, colors=printer.photographed(printer.to_send(cloaked.colors)))
        place = f"{place}-printed"
    if settings.cycles is not None:
        place = f"{place}-{settings.cycles}"
    judges = _by_name([trained["spec"] for trained in config["detectors"]] if detectors is None else detectors, device)
    angles = from_plain("angles", angles, Angles) if isinstance(angles, str) else angles
    target = folder / place if out is None else Path(out)
    if (target / "summary.json").exists():
        _log.warning("%s: holds an evaluation already, which this one replaces (--out DIR keeps both)", target)
    asked = (cloaked, judges, angles, settings)
    summary = evaluate_logo(*asked, training=trained, out=target, on_progress=on_progress)
    if over_time:
        summary["over_time"] = judge_snapshots(folder, *asked, on_progress)
    return summary


def _on_people(
    folder: Path,
    config: dict,
    people: People | Named,
    detectors: dict[str, Detector],
    backgrounds: Backgrounds | Named | None,
    out: Path,
    settings: EvaluateSettings,
    on_progress: OnProgress | None,
) -> dict:
    from cloak_core.core.evaluation.settings import WearSettings
    from cloak_core.studies.wearing.wearing import evaluate_on_people

    chosen = WearSettings(size=settings.size, threshold=settings.threshold, bare=settings.bare, batch=settings.batch)
    people = people if isinstance(people, People) else load_people(people)
    if not isinstance(backgrounds, Backgrounds):
        backgrounds = load_backgrounds(backgrounds or "procedural:test")
    return evaluate_on_people(folder, config, people, detectors, backgrounds, out, chosen, on_progress)


def film(
    run: RunResult | Named,
    out: Named,
    scene: Bodies | Named | None = None,
    backgrounds: Backgrounds | Named | None = None,
    detectors: Mapping[str, Detector] | Detector | str | Sequence[Detector | str] | None = None,
    *,
    colors: Named | None = None,
    settings: FilmSettings | None = None,
    device: str = "cpu",
    on_progress: OnProgress | None = None,
) -> dict:
    """Film a run's colours in motion beside the body's own clothing: NAME.mp4, NAME.gif, or a folder of PNGs.

    The scene's poses in their order are the motion; all else is as in `evaluate`. Returns what `cloak film --json`
    prints: frames hidden, the longest visible run, first sight, tracks; per detector for colours and clothing.
    InputError: as in `evaluate`; another kind of film, no PyAV for a .mp4.
    """
    from cloak_core.studies.cloaked import open_cloaked
    from cloak_core.studies.film import make_film

    folder = Path(run.out) if isinstance(run, RunResult) else run_path(run)
    config = read_run(folder)
    cloaked, _, _ = open_cloaked(folder, config, scene, backgrounds, colors)
    judges = _by_name([trained["spec"] for trained in config["detectors"]] if detectors is None else detectors, device)
    return make_film(cloaked, judges, Path(out), settings, on_progress)


def wear(
    colors: Named | Sequence[Named],
    people: People | Named,
    detectors: Mapping[str, Detector] | Sequence[Detector | str],
    backgrounds: Backgrounds | Named = "procedural:test",
    *,
    images: Named | None = None,
    out: Named | None = None,
    settings: WearSettings | None = None,
    device: str = "cpu",
    on_progress: OnProgress | None = None,
    width_people: People | Named | None = None,
    width_detectors: Mapping[str, Detector] | Sequence[Detector | str] = (),
    **changes: object,
) -> dict:
    """Dress people in photographs in trained colours or pictures, and judge them beside controls.

    colors: each a run folder, zoo:NAME, PICTURE@tile=METRES or PICTURE@patch=METRES; PICTURE: a file, print:NAME, or a
    run of cloth. people: what `load_people` gave, or a COCO file (its photographs in `images`). backgrounds: without
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
    scenes = backgrounds if isinstance(backgrounds, Backgrounds) else load_backgrounds(backgrounds)
    judging = (people if isinstance(people, People) else load_people(people, images), _by_name(detectors, device))
    choosing = None
    if width_people is not None:
        choosing = width_people if isinstance(width_people, People) else load_people(width_people, images)
    choosers = _by_name(width_detectors, device) if len(width_detectors) else {}
    colors, widths = choose_widths(given, choosing, choosers, judging, scenes, settings, on_progress)
    more = {"widths": widths} if widths else None
    return wear_and_judge(colors, *judging, scenes, None if out is None else Path(out), settings, on_progress, more)


def _fitted(people: People | Named | None) -> list[Fit]:
    """Fit bodies to the people, or find them in the cache."""
    if people is None:
        return []
    from cloak_core.sources.photographs.fits import fit_people

    return fit_people(people if isinstance(people, People) else load_people(people))


def _either(settings: T | None, changes: dict, make: Callable[..., T]) -> T:
    """Take the settings, or make them by the changes. TypeError: both are given."""
    if settings is not None and changes:
        raise TypeError(f"settings are given: change {', '.join(changes)} there")
    return make(**changes) if settings is None else settings


def _detector(detector: Detector | str, device: str) -> Detector:
    return load_detector(detector, device=device) if isinstance(detector, str) else detector


def _several(detectors: Detector | str | Sequence[Detector | str]) -> Sequence[Detector | str]:
    """Make one detector, or one spec, a list of one."""
    return [detectors] if isinstance(detectors, (Detector, str)) else detectors


def _by_name(
    detectors: Mapping[str, Detector] | Detector | str | Sequence[Detector | str], device: str
) -> dict[str, Detector]:
    if isinstance(detectors, Mapping):
        return dict(detectors)
    return {given if isinstance(given, str) else given.spec: _detector(given, device) for given in _several(detectors)}
