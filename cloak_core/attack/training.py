"""Training: body + detectors + backgrounds -> the colours of a logo.

One step: draw bodies, cameras, backgrounds and augmentations; compose the images; ask the detectors; move the colours
against the gradient of the loss; keep them in [0, 1]. This puts the parts together; `loop` has the steps.
"""

import contextlib
import importlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from cloak_core.attack.batches import Batcher, require_visible_logo
from cloak_core.attack.ensemble import Ensemble
from cloak_core.attack.events import OnEvent
from cloak_core.attack.fabric import Fabric
from cloak_core.attack.first_colors import first_colors
from cloak_core.attack.held_out import HeldOut, TrainingData, held_out_settings, set_aside
from cloak_core.attack.loop import RunResult, TrainingError, TrainingLoop
from cloak_core.attack.objective import Objective
from cloak_core.attack.optimizing import ColorOptimizer
from cloak_core.attack.people import PeopleViews
from cloak_core.attack.run_config import RunInputs, run_config
from cloak_core.attack.run_folder import RunFolder, open_run
from cloak_core.attack.sampling import Sampler, is_fresh
from cloak_core.attack.settings import TrainSettings
from cloak_core.attack.settings.components import ViewSettings
from cloak_core.attack.stopping import stop_request
from cloak_core.attack.technique import NO_TECHNIQUES, Setup, Techniques
from cloak_core.attack.world import LostProcess, World, join_world, local_device
from cloak_core.detectors.protocol import Detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.render.photographs.fitting import Fit
from cloak_core.render.settings import RenderSettings
from cloak_core.render.view_cache import ViewCache
from cloak_core.render.view_files import view_files
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.logos.logo import Logo

FRESH_VIEWS_BYTES = 128 << 20
"""Memory for views that are used once."""
FRESH_SAMPLES = 4
"""Per pixel, in views that are used once, unless settings say otherwise: what sampling misses of a face in one view it
finds in the next, so that the error of single gradients averages out as the noise of small batches does."""


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
    people: Sequence[Fit] = (),
) -> RunResult:
    """Train the logo's colours into the run folder `out`.

    The loss is the ensemble's disappearance loss (the mean over `detectors` unless the settings say otherwise), plus
    weighted total variation and what techniques add. A search by questions (`black_box_queries`) looks where the
    gradients of the detectors of `query_prior` point. `people`: fitted people in photographs, shown in the share of the
    images that the settings say. `on_event` hears every event that goes to events.jsonl. `inputs` (paths and specs, as
    the user gave them) are recorded.
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
    Ensemble(settings.objective, len(detectors))  # refuses what does not fit
    if logo.topology != bodies.topology:
        raise InputError(f"the logo: made for topology {logo.topology}, but the scene has {bodies.topology}")
    material = TrainingData(bodies, backgrounds, tuple(people))
    job = Job(settings, material, logo, detectors, query_prior, dict(inputs or {}))
    try:
        with join_world(local_device(settings.compute.device), alone) as world:
            return _train(job, Path(out), resume, on_event, world)
    except LostProcess as lost:
        raise TrainingError(f"{out}: lost another process of this run ({lost}); --resume goes on") from None


@dataclass(frozen=True, eq=False)
class Job:
    """What was asked for."""

    settings: TrainSettings
    material: TrainingData
    logo: Logo
    detectors: Sequence[Detector]
    query_prior: Sequence[Detector]
    inputs: dict[str, str]
    """As the user gave them."""


def _train(job: Job, out: Path, resume: bool, on_event: OnEvent | None, world: World) -> RunResult:
    settings, logo, bodies = job.settings, job.logo, job.material.bodies
    device = local_device(settings.compute.device)
    detectors = [detector.to(device) for detector in job.detectors]
    fabric = Fabric.of(settings.pattern, bodies, logo)
    techniques = Techniques.built(Setup(settings, fabric, detectors, device))
    trained, held = set_aside(settings.run, job.material)
    search = None
    if settings.queries.black_box_queries is not None:
        _require_plain(settings, techniques, held, world)
        # By name: who reads how training goes need not read how searching does.
        search = importlib.import_module("cloak_core.attack.black_box")
    drawn = settings if search is None else search.search_settings(settings, len(detectors))
    batcher = make_batcher(drawn, trained, fabric, device, techniques)
    if not job.material.people or settings.photographs.people_share < 1:
        require_visible_logo(batcher.view_cache, logo.face_ids, trained.bodies.pose_count, settings.views)
    more = RunInputs(world.size, held, techniques.content(), job.query_prior, job.material.people)
    config = run_config(settings, bodies, logo, detectors, job.material.backgrounds, job.inputs, more)
    begun = [technique.first() for technique in techniques.at("first")]
    start = begun[0] if begun else first_colors(settings.optimization, bodies, logo, settings.run.seed).numpy()
    first = torch.from_numpy(fabric.colors(start)).to(device)
    with contextlib.ExitStack() as stack:
        run = world.on_rank0(lambda: stack.enter_context(open_run(out, config, logo, resume))) or RunFolder(out)
        stop = stack.enter_context(stop_request(run.cancel, settings.run.max_seconds))
        objective = Objective(drawn, fabric.bordered, detectors, device, techniques)
        if search is None:
            held_out = None
            if held is not None:
                measured = make_batcher(held_out_settings(settings), held, fabric, device, techniques)
                held_out = HeldOut(settings.run, measured, objective, world)
            optimizer = ColorOptimizer(settings.optimization, first, techniques, fabric)
            loop = TrainingLoop(settings, run, batcher, objective, optimizer, held_out, on_event, world)
        else:
            prior = None
            if job.query_prior:
                surrogates = [detector.to(device) for detector in job.query_prior]
                prior = search.QueryPrior(Objective(drawn, logo, surrogates, device, techniques), fabric.centres)
            loop = search.Search(drawn, run, batcher, objective, first, on_event, world, fabric.centres, prior)
        result = loop.run_to_end(stop)
    for detector, record in zip(detectors, config["detectors"], strict=True):
        detector.verify(record["sha256"])
    return result


def training_config(settings: TrainSettings, material: TrainingData, logo: Logo, detectors: Sequence[Detector]) -> dict:
    """Make the configuration of a training that is not begun: its `decisive` parts are those that it would record."""
    fabric = Fabric.of(settings.pattern, material.bodies, logo)
    techniques = Techniques.built(Setup(settings, fabric, detectors, torch.device("cpu")))
    more = RunInputs(files=techniques.content(), people=material.people)
    return run_config(settings, material.bodies, logo, detectors, material.backgrounds, {}, more)


def _require_plain(settings: TrainSettings, techniques: Techniques, held: TrainingData | None, world: World) -> None:
    """Refuse what a search by questions does not do. InputError."""
    if held is not None or world.size > 1:
        raise InputError("--black-box-queries: searches in one process, without --held-out")
    if settings.pattern.pattern != "free" or any(technique.bars_search for technique in techniques):
        refused = "--colors-at-most, --pattern, --profile, --near and --octaves"
        raise InputError(f"--black-box-queries: free colours alone, without {refused}")


def make_view_cache(bodies: Bodies, settings: ViewSettings, device: torch.device, on_cloth: bool = False) -> ViewCache:
    """Make the cache of a run's views, kept for the next run unless each image has a camera of its own."""
    if is_fresh(settings):
        fresh = {"samples": settings.samples or FRESH_SAMPLES, "memory_bytes": FRESH_VIEWS_BYTES}
        return ViewCache(bodies, RenderSettings.of(settings, device=device, **fresh), on_cloth=on_cloth)
    return ViewCache(bodies, RenderSettings.of(settings, device=device, files=view_files()), on_cloth=on_cloth)


def make_batcher(
    settings: TrainSettings,
    material: TrainingData,
    fabric: Fabric,
    device: torch.device,
    techniques: Techniques = NO_TECHNIQUES,
) -> Batcher:
    """Make what draws and builds a run's batches."""
    bodies, backgrounds, faces = material.bodies, material.backgrounds, fabric.logo.face_ids
    sampler = Sampler(settings, bodies.pose_count, bodies.outfit_count, len(backgrounds), len(material.people))
    people = None
    if material.people:
        flat = None if fabric.cloth is None else fabric.cloth.cloth
        people = PeopleViews(material.people, fabric.logo, settings.photographs, settings.views.size, flat)
    view_cache = make_view_cache(bodies, settings.views, device, fabric.cloth is not None)
    return Batcher(settings, sampler, view_cache, faces, backgrounds, device, people, fabric.cloth, techniques)
