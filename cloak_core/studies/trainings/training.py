"""Training: body + detectors + backgrounds -> the colours of a logo.

One step: draw bodies, cameras, backgrounds and augmentations; compose the images; ask the detectors; move the colours
against the gradient of the loss; keep them in [0, 1]. This puts the parts together; `loop` has the steps.
"""

import contextlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int64

from cloak_core.core.batches import Batcher, require_visible_logo
from cloak_core.core.black_box import QueryPrior, Search, search_settings
from cloak_core.core.cloth import Cloth
from cloak_core.core.cloth_on_logo import ClothOnLogo
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.ensemble import Ensemble
from cloak_core.core.events import OnEvent
from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.core.held_out import HeldOut, TrainingData, held_out_settings, set_aside
from cloak_core.core.logo import Logo
from cloak_core.core.loop import RunResult, TrainingError, TrainingLoop
from cloak_core.core.near import Near
from cloak_core.core.objective import Objective
from cloak_core.core.octaves import Octaves
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.patches import patch_of_face
from cloak_core.core.pattern import Inks, Pattern, Smoothing
from cloak_core.core.people import PeopleViews
from cloak_core.core.run_config import run_config
from cloak_core.core.run_folder import RunFolder, open_run, read_start
from cloak_core.core.sampling import Sampler, is_fresh
from cloak_core.core.settings import TrainSettings
from cloak_core.core.settings.components import PatternSettings, ViewSettings
from cloak_core.core.stopping import stop_request
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.core.world import LostProcess, World, join_world, local_device
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.profiles import Profile, read_profile
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.logos.garment_colors import garment_colors
from cloak_core.sources.bodies.logos.palette import read_palette
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.sources.bodies.view_files import view_files
from cloak_core.sources.bodies.wrinkling import wrinkled
from cloak_core.sources.photographs.fitting import Fit
from cloak_core.studies.trainings.first_colors import first_colors, on_squares

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
    weighted total variation and printability. A search by questions (`black_box_queries`) looks where the gradients of
    the detectors of `query_prior` point. `people`: fitted people in photographs, shown in the share of the images that
    the settings say. `on_event` hears every event that goes to events.jsonl. `inputs` (paths
    and specs, as the user gave them) are recorded.
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
        if detector.compiled and settings.surrogates.on:
            raise InputError(f"--detector {detector.spec}: compiled, so --shake and the like do not reach into it")
    Ensemble(settings.objective, len(detectors))  # refuses what does not fit
    if logo.topology != bodies.topology:
        raise InputError(f"the logo: made for topology {logo.topology}, but the scene has {bodies.topology}")
    device = local_device(settings.compute.device)
    try:
        with join_world(device, alone) as world:
            parties = (detectors, query_prior)
            material = TrainingData(bodies, backgrounds, tuple(people))
            return _train(settings, material, logo, parties, Path(out), resume, on_event, inputs, world)
    except LostProcess as lost:
        raise TrainingError(f"{out}: lost another process of this run ({lost}); --resume goes on") from None


def _train(
    settings: TrainSettings,
    material: TrainingData,
    logo: Logo,
    parties: tuple[Sequence[Detector], Sequence[Detector]],
    out: Path,
    resume: bool,
    on_event: OnEvent | None,
    inputs: Mapping[str, str] | None,
    world: World,
) -> RunResult:
    device, bodies = local_device(settings.compute.device), material.bodies
    detectors, surrogates = ([detector.to(device) for detector in group] for group in parties)
    palette_file, profile_file, init = settings.objective.palette, settings.pattern.profile, settings.optimization.init
    palette = None if palette_file is None else read_palette(palette_file)
    profile = None if profile_file is None else read_profile(profile_file)
    start = None if init is None else read_start(Path(init), logo)
    near = None if settings.pattern.near is None else make_near(settings.pattern, bodies, logo)
    trained, held = set_aside(settings.run, material)
    is_search = settings.queries.black_box_queries is not None
    if is_search:
        _require_plain(settings, held, world)
    drawn = search_settings(settings, len(detectors)) if is_search else settings
    cloth = make_cloth(settings.pattern, bodies, logo)
    batcher = make_batcher(drawn, trained, logo, device, cloth)
    if not material.people or settings.photographs.people_share < 1:
        require_visible_logo(batcher.view_cache, logo.face_ids, trained.bodies.pose_count, settings.views)
    given = (world.size, palette, held, start, profile, surrogates, material.people)
    garment, seen = None if near is None else near.garment, material.backgrounds
    config = run_config(settings, bodies, logo, detectors, seen, inputs or {}, *given, near=garment)
    if start is None:
        first = first_colors(settings.optimization, bodies, logo, settings.run.seed, device)
    else:
        first = torch.from_numpy(start).to(device)
    if cloth is not None:
        first = on_squares(cloth, settings.optimization, first)
    with contextlib.ExitStack() as stack:
        run = world.on_rank0(lambda: stack.enter_context(open_run(out, config, logo, resume))) or RunFolder(out)
        stop = stack.enter_context(stop_request(run.cancel, settings.run.max_seconds))
        objective = Objective(drawn, logo if cloth is None else cloth.as_logo(logo), detectors, device, palette)
        if is_search:
            centres = face_centres(bodies)[logo.face_ids]
            prior = QueryPrior(Objective(drawn, logo, surrogates, device), centres) if surrogates else None
            loop = Search(settings, run, batcher, objective, first, centres, on_event, prior)
        else:
            held_out = None if held is None else _held_out(settings, held, logo, objective, world, cloth)
            patch = patches(settings.pattern, bodies, logo)
            pattern = make_pattern(settings, logo, patch, cloth, palette, profile, device)
            begun = first if pattern is None else pattern.begin(first)
            octaves = make_octaves(settings, bodies, logo, patch, cloth, device)
            optimizer = ColorOptimizer(settings.optimization, begun, pattern, near, octaves)
            loop = TrainingLoop(settings, run, batcher, objective, optimizer, held_out, on_event, world)
        result = loop.run_to_end(stop)
    for detector, record in zip(detectors, config["detectors"], strict=True):
        detector.verify(record["sha256"])
    return result


def _require_plain(settings: TrainSettings, held: TrainingData | None, world: World) -> None:
    """Refuse what a search by questions does not do. InputError."""
    if held is not None or world.size > 1:
        raise InputError("--black-box-queries: searches in one process, without --held-out")
    if settings.pattern.on or settings.optimization.octaves > 1:
        refused = "--colors-at-most, --pattern, --profile, --near and --octaves"
        raise InputError(f"--black-box-queries: free colours alone, without {refused}")


def make_pattern(
    settings: TrainSettings,
    logo: Logo,
    patch: Int64[np.ndarray, " L"] | None,
    cloth: ClothOnLogo | None,
    palette: np.ndarray | None,
    profile: Profile | None,
    device: torch.device,
) -> Pattern | None:
    """Make what turns free values into colours; None where these are the colours."""
    wanted, rounds, inks = settings.pattern, settings.optimization.smooth, None
    edges, count = (logo.edges, len(logo)) if cloth is None else (cloth.cloth.neighbours(), cloth.count)
    if patch is not None:
        edges, count = patch[edges], int(patch.max()) + 1
        edges = edges[edges[:, 0] != edges[:, 1]]
    if wanted.colors_at_most is not None:
        given = None if palette is None else torch.as_tensor(palette, dtype=torch.float32, device=device)
        inks = Inks(wanted.colors_at_most, given)
    smoothing = Smoothing(edges, count, rounds, device) if rounds else None
    is_free = smoothing is patch is profile is inks is None
    if wanted.near is not None and inks is not None and inks.given is not None:
        raise InputError("--near: would move colours away from those of --palette; give --colors-at-most alone")
    return None if is_free else Pattern(smoothing, patch, profile, inks, device)


def patches(wanted: PatternSettings, bodies: Bodies, logo: Logo) -> Int64[np.ndarray, " L"] | None:
    """Number the patch whose colour each face has; None where faces share none."""
    return patch_of_face(bodies, logo, wanted.feature_cm / 100) if wanted.pattern == "camouflage" else None


def make_cloth(wanted: PatternSettings, bodies: Bodies, logo: Logo) -> ClothOnLogo | None:
    """Lay a cloth that repeats onto the logo; None where its faces have colours of their own."""
    if wanted.pattern != "tile":
        return None
    return ClothOnLogo.of(Cloth.of(wanted.tile_cm / 100, wanted.feature_cm / 100), bodies, logo)


def make_octaves(
    settings: TrainSettings,
    bodies: Bodies,
    logo: Logo,
    patch: Int64[np.ndarray, " L"] | None,
    cloth: ClothOnLogo | None,
    device: torch.device,
) -> Octaves | None:
    """Coarse grids over the faces, patches or squares that have colours; None where there is one scale alone."""
    count = settings.optimization.octaves
    if count == 1:
        return None
    if cloth is not None:
        width = cloth.cloth.metres / cloth.cloth.count
        return Octaves(cloth.cloth.centres(), width, count, cloth.cloth.metres, device)
    centres, areas = face_centres(bodies)[logo.face_ids], face_areas(bodies)[logo.face_ids]
    if patch is not None:
        members = np.bincount(patch)
        centres = np.stack([np.bincount(patch, axis) for axis in centres.T], axis=1) / members[:, None]
        areas = np.bincount(patch, areas)
    return Octaves(centres, float(np.sqrt(np.median(areas))), count, None, device)


def make_near(wanted: PatternSettings, bodies: Bodies, logo: Logo) -> Near:
    """Find the garment that the colours stay close to, and how close.

    Where faces share colours, the garment in their mean.

    InputError: no such garment; one of several colours where inks are counted.
    """
    garment = garment_colors(wanted.near, bodies, logo)
    garment = read_start(Path(wanted.near), logo, "--near") if garment is None else garment
    if wanted.colors_at_most is not None and len(np.unique(garment, axis=0)) > 1:
        raise InputError("--near: with --colors-at-most the garment must have one colour")
    patch, cloth = patches(wanted, bodies, logo), make_cloth(wanted, bodies, logo)
    if cloth is not None:
        garment = cloth.of_faces(garment)
    if patch is not None:
        total = np.stack([np.bincount(patch, garment[:, channel]) for channel in range(3)], axis=1)
        garment = (total / np.bincount(patch)[:, None])[patch].astype(np.float32)
    return Near(garment, wanted.within, wanted.within_most or 2 * wanted.within)


def _held_out(
    settings: TrainSettings,
    held: TrainingData,
    logo: Logo,
    objective: Objective,
    world: World,
    cloth: ClothOnLogo | None,
) -> HeldOut:
    batcher = make_batcher(held_out_settings(settings), held, logo, local_device(settings.compute.device), cloth)
    return HeldOut(settings.run, batcher, objective, world)


def make_view_cache(bodies: Bodies, settings: ViewSettings, device: torch.device) -> ViewCache:
    """Make the cache of a run's views, kept for the next run unless each image has a camera of its own."""
    if is_fresh(settings):
        fresh = {"samples": settings.samples or FRESH_SAMPLES, "memory_bytes": FRESH_VIEWS_BYTES}
        return ViewCache(bodies, RenderSettings.of(settings, device=device, **fresh))
    return ViewCache(bodies, RenderSettings.of(settings, device=device, files=view_files()))


def make_batcher(
    settings: TrainSettings,
    material: TrainingData,
    logo: Logo,
    device: torch.device,
    cloth: ClothOnLogo | None = None,
) -> Batcher:
    """Make what draws and builds a run's batches."""
    bodies, backgrounds, folds = material.bodies, material.backgrounds, settings.augmentation
    if folds.wrinkles:
        bodies = wrinkled(bodies, logo.face_ids, folds.wrinkles, folds.wrinkle_draws, settings.run.seed)
    sampler = Sampler(settings, bodies.pose_count, bodies.outfit_count, len(backgrounds), len(material.people))
    people, flat = None, None if cloth is None else cloth.cloth
    if material.people:
        people = PeopleViews(material.people, logo, settings.photographs, settings.views.size, flat)
    view_cache = make_view_cache(bodies, settings.views, device)
    return Batcher(settings, sampler, view_cache, logo.face_ids, backgrounds, device, people, cloth)
