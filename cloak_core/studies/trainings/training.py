"""Train on bodies and whoever is shown beside them: sources, record, and the training itself (`train`)."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32

from cloak_core.core.coloring import Coloring
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.events import OnEvent
from cloak_core.core.geometry import face_centres, face_normals
from cloak_core.core.logo import Logo
from cloak_core.core.loop import TrainingError
from cloak_core.core.pattern import Pattern
from cloak_core.core.places import face_places
from cloak_core.core.prints import PRINT_METRES, PRINTS
from cloak_core.core.settings import TrainSettings
from cloak_core.core.settings.components import OptimizerSettings
from cloak_core.core.source import NOBODY, Cast, Source
from cloak_core.core.technique import Technique, Techniques, call_package
from cloak_core.core.train import TrainingJob, run_training
from cloak_core.core.training import RunResult
from cloak_core.core.world import LostProcess, World, join_world, local_device
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.patterns.choosing import pattern_of
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.source import BodySource
from cloak_core.studies.trainings.run_record import Training, run_config
from cloak_core.techniques import build_techniques
from cloak_core.zoo.entry import read_start


def train(
    settings: TrainSettings,
    bodies: Bodies,
    logo: Logo,
    detectors: Sequence[Detector],
    backgrounds: Backgrounds,
    out: str | os.PathLike,
    *,
    resume: bool = False,
    on_event: OnEvent | None = None,
    inputs: Mapping[str, str] | None = None,
    alone: bool = False,
    query_prior: Sequence[Detector] = (),
    people: Cast = NOBODY,
    techniques: Sequence[str] = (),
) -> RunResult:
    """Train the logo's colours into the run folder `out`.

    The loss is the ensemble's disappearance loss (the mean over `detectors` unless the settings say otherwise), plus
    weighted total variation and what techniques add. A search by questions (`black_box_queries`) looks where the
    gradients of the detectors of `query_prior` point. `people`: who is shown beside the bodies, in the share of
    the images that the settings say. `techniques` of other packages, NAME or NAME:TEXT, act beside those that the
    settings have on. `on_event` hears every event that goes to events.jsonl. `inputs` (paths and specs, as the user
    gave them) are recorded.
    Under torchrun its processes train together, unless this one is to train `alone`.
    Nothing of the process is changed: threads and the like are the caller's (`torch.set_num_threads`).
    SIGINT, SIGTERM, a file `cancel` in `out` or the time budget end it after the current step with a checkpoint;
    `resume` then continues to the bit-identical result on the same device and number of threads.

    Raises InputError: `out` exists (without `resume`), belongs to other inputs or is in use; the logo is another
    body's, or no training view sees it; a detector cannot be trained against. TrainingError: the loss is not finite.
    """
    if not detectors:
        raise InputError("--detector: none given")
    if query_prior and settings.queries.black_box_queries is None:
        raise InputError("--query-prior: only leads a search (--black-box-queries)")
    for detector in detectors:
        if not detector.differentiable and settings.queries.black_box_queries is None:
            hint = "ask for its answers alone with --black-box-queries"
            raise InputError(
                f"--detector {detector.spec}: gives no gradients, so nothing can be trained by them; {hint}"
            )
    if logo.topology != bodies.topology:
        raise InputError(f"the logo: made for topology {logo.topology}, but the scene has {bodies.topology}")
    training = Training(settings, bodies, logo, detectors, backgrounds, people, query_prior, techniques, inputs or {})
    source = make_source(training)  # may take long, which other processes of this run must not wait for
    try:
        with join_world(local_device(settings.compute.device), alone) as world:
            return run_training(make_job(training, source, world), Path(out), resume, on_event, world)
    except LostProcess as lost:
        raise TrainingError(f"{out}: lost another process of this run ({lost}); --resume goes on") from None


def make_job(training: Training, source: Source, world: World) -> TrainingJob:
    """Make the training that was asked for. InputError: something does not go together, or cannot be read."""
    settings, bodies, logo = training.settings, training.bodies, training.logo
    device = local_device(settings.compute.device)
    detectors = [detector.to(device) for detector in training.detectors]
    surrogates = [detector.to(device) for detector in training.query_prior]
    pattern = pattern_of(settings.pattern, bodies, logo)
    start = _start(training)
    techniques, coloring, files = _techniques(training, pattern, detectors, device)
    if start is None:
        first = first_colors(settings.optimization, pattern, bodies, settings.run.seed)
    else:
        first = pattern.from_faces(start)
    config = run_config(training, world.size, files | _content(start))
    source.require_visible(pattern)
    backgrounds = training.backgrounds
    return TrainingJob(
        settings, pattern, first, techniques, coloring, source, backgrounds, detectors, surrogates, config
    )


def _techniques(
    training: Training, pattern: Pattern, detectors: Sequence[Detector], device: torch.device
) -> tuple[Techniques, Coloring, dict[str, object]]:
    """Build the techniques, other packages' last, what makes colours with them, and their part of config.json."""
    settings = training.settings
    foreign = [
        call_package("cloak.techniques", spec, Technique, settings, pattern, detectors, device)
        for spec in training.techniques
    ]
    techniques, coloring = build_techniques(settings, pattern, detectors, device, [made for made, _ in foreign])
    files = {name: value for part in (*techniques, coloring) for name, value in part.content().items()}
    if foreign:
        files["techniques"] = [record for _, record in foreign]
    return techniques, coloring, files


def _start(training: Training) -> Float32[np.ndarray, "L 3"] | None:
    """Read the colours that --init names; None where it names none. InputError: they do not fit the logo."""
    path = training.settings.optimization.init
    return None if path is None else read_start(Path(path), training.logo)


def _content(start: Float32[np.ndarray, "L 3"] | None) -> dict[str, object]:
    """Record the first colours that --init names, where it names any."""
    return {} if start is None else {"start": {"sha256": sha256_arrays(start)}}


def make_source(training: Training) -> Source:
    """Make the source of bodies, with whoever is shown beside them."""
    settings = training.settings
    device = local_device(settings.compute.device)
    return training.people.beside(BodySource.trained(training.bodies, settings.views, device), settings, device)


def training_config(training: Training) -> dict:
    """Make the configuration of a training that is not begun: its `decisive` parts are those that it would record."""
    pattern = pattern_of(training.settings.pattern, training.bodies, training.logo)
    _, _, files = _techniques(training, pattern, training.detectors, torch.device("cpu"))
    return run_config(training, files=files | _content(_start(training)))


# --- the colours that a training begins with: of faces, or of the squares of a cloth

FUR, COAT, DARK, MOUTH = (0.9, 0.85, 0.75), (0.75, 0.45, 0.15), (0.02, 0.02, 0.02), (0.25, 0.12, 0.08)
# Places in the face, in its heights: across from its middle, down from its top.
HALF_WIDTH, FOREHEAD, CHEEKS, CHEEKS_END = 0.3, 0.24, 0.21, 0.65
BLOBS = (
    (-0.16, 0.27, 0.053, 0.045, DARK),
    (0.16, 0.27, 0.053, 0.045, DARK),
    (0.0, 0.52, 0.1, 0.075, DARK),
    (0.0, 0.92, 0.12, 0.075, MOUTH),
)
"""Eyes, nose and mouth: place, half width and half height, colour."""
TALL = 0.38
"""Height of the face, of the body's; less where the logo has no room."""
COLUMN, GAP = 0.06, 0.05
"""Of the body's height: half the width of the strip about the middle that is looked at for room, and what parts it."""


def first_colors(
    settings: OptimizerSettings, pattern: Pattern, bodies: Bodies, seed: int = 0
) -> Float[np.ndarray, "C 3"]:
    """Make a pattern's first colours: grey, seeded random ones, the first outfit's, an animal's face, or a print."""
    logo = pattern.cover
    if settings.initial in PRINTS:
        plain = PRINTS[settings.initial]
        if not pattern.period:
            return pattern.from_faces(plain.at(face_places(bodies, logo).at.T.double().numpy()))
        # What repeats shows as many whole pieces as come closest to their own size.
        pieces = max(1, round(pattern.period / PRINT_METRES))
        return plain.at(pattern.centres / pattern.period * pieces * PRINT_METRES)
    if settings.initial == "clothing":
        colors = bodies.face_colors[0, logo.face_ids]
    elif settings.initial == "animal":
        colors = animal_face(bodies, logo)
    elif settings.initial == "random":
        colors = torch.rand((len(logo), 3), generator=torch.Generator().manual_seed(seed)).numpy()
    else:
        colors = np.full((len(logo), 3), 0.5, np.float32)
    return pattern.from_faces(colors)


def animal_face(bodies: Bodies, logo: Logo) -> Float32[np.ndarray, "L 3"]:
    """Draw a dog's face on front and back, on grey: light fur, a brown coat, two eyes, nose and mouth.

    Each is as high as 0.38 of the body in its first pose, or as the logo has room along the middle, and begins where
    that does. Trainings for detectors of many classes that end well have drawn such a face by themselves.
    """
    centres, facing = face_centres(bodies)[logo.face_ids], face_normals(bodies)[logo.face_ids, 2]
    points = bodies.vertices[0]
    tall = float(np.ptp(points[:, 1]))
    colors = np.full((len(logo), 3), 0.5, np.float32)
    for side in (facing > 0, facing < 0):
        room = _room(centres[side], tall)
        if room is None:
            continue
        middle, top, height = room
        size = min(TALL * tall, height)
        _draw(colors, (centres[:, 0] - middle) / size, (top - centres[:, 1]) / size, side)
    return colors


def _room(centres: Float[np.ndarray, "faces 3"], tall: float) -> tuple[float, float, float] | None:
    """Find the longest strip without a gap along the middle of one side's faces: middle, top, height; metres."""
    middle = float(np.median(centres[:, 0])) if len(centres) else 0.0
    column = np.sort(centres[abs(centres[:, 0] - middle) <= COLUMN * tall, 1])
    if not len(column):
        return None
    strips = np.split(column, np.flatnonzero(np.diff(column) > GAP * tall) + 1)
    longest = max(strips, key=np.ptp)
    height = float(np.ptp(longest))
    return (middle, float(longest[-1]), height) if height > 0 else None


def _draw(
    colors: Float32[np.ndarray, "L 3"],
    across: Float[np.ndarray, " L"],
    down: Float[np.ndarray, " L"],
    side: Bool[np.ndarray, " L"],
) -> None:
    """Draw the face onto the faces of one side, in place."""
    inside = side & (abs(across) < HALF_WIDTH) & (down >= 0) & (down < 1)
    colors[inside] = FUR
    colors[inside & ((down < FOREHEAD) | ((abs(across) > CHEEKS) & (down < CHEEKS_END)))] = COAT
    for x, y, half_width, half_height, color in BLOBS:
        colors[inside & (((across - x) / half_width) ** 2 + ((down - y) / half_height) ** 2 < 1)] = color
