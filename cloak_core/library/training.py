"""Train a logo's colours in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cloak_core.core.events import OnEvent
from cloak_core.core.logo import Logo, load_logo
from cloak_core.core.settings import TrainSettings, make_settings
from cloak_core.core.surroundings import plain_torch
from cloak_core.core.training import RunResult
from cloak_core.detectors.loading import Given, as_detectors
from cloak_core.exchange.bodies import Bodies
from cloak_core.library.values import Named, cast_of, made_settings, open_backgrounds, open_bodies
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.studies.trainings.training import train as train_logo

if TYPE_CHECKING:
    from cloak_core.sources.photographs.people import People


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
    settings = made_settings(settings, changes, make_settings)
    if scene is None:
        scene, settings = "sample:train", cast.alone(settings)
    bodies = open_bodies(scene)
    return train_logo(
        settings,
        bodies,
        logo if isinstance(logo, Logo) else load_logo(bodies, logo),
        as_detectors(detectors, settings.compute.device),
        open_backgrounds(backgrounds),
        out,
        resume=resume,
        on_event=None if on_event is None else _stopping(on_event, Path(out)),
        inputs={key: str(value) for key, value in named.items() if isinstance(value, Named)} | dict(inputs or {}),
        query_prior=as_detectors(query_prior, settings.compute.device),
        people=cast,
        techniques=techniques,
    )


def _stopping(on_event: OnEvent, out: Path) -> OnEvent:
    """Have a listener that returns True end the run, as a file named `cancel` in its folder does."""

    def listener(event: dict) -> None:
        if on_event(event) is True:
            (out / "cancel").touch()

    return listener
