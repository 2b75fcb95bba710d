"""Training: views of something worn + detectors + backgrounds -> its colours.

One step: draw views, backgrounds and augmentations; compose the images; ask the detectors; move the colours against the
gradient of the loss; keep them in [0, 1]. This puts the parts together; `loop` has the steps. What makes the views
(`source`), what is worn (`pattern`) and which techniques act is the caller's choice.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from cloak_core.core.batches import Batcher
from cloak_core.core.coloring import Coloring
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.events import OnEvent
from cloak_core.core.loop import stop_request
from cloak_core.core.objective import Objective
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.pattern import Pattern
from cloak_core.core.run_folder import RunFolder, open_run
from cloak_core.core.sampling import Sampler
from cloak_core.core.settings import TrainSettings
from cloak_core.core.source import Backdrops, Source
from cloak_core.core.technique import Techniques
from cloak_core.core.training import RunResult, TrainingLoop
from cloak_core.core.world import World, local_device
from cloak_core.files.errors import InputError


@dataclass(frozen=True, eq=False)
class TrainingJob:
    """One training."""

    settings: TrainSettings
    pattern: Pattern
    first: Float[np.ndarray, "C 3"]
    """The colours to begin with."""
    techniques: Techniques
    coloring: Coloring
    """Makes the pattern's colours, with what techniques allow."""
    source: Source
    backgrounds: Backdrops
    detectors: Sequence[Detector]
    query_prior: Sequence[Detector]
    """Whose gradients lead a search by questions."""
    config: Mapping[str, object]
    """The record of all that decides the result, for the run folder."""


def run_training(job: TrainingJob, out: Path, resume: bool, on_event: OnEvent | None, world: World) -> RunResult:
    """Train into the run folder `out`, in each process of `world`. InputError: the folder, a detector that changed."""
    settings = job.settings
    pattern = job.pattern
    techniques = job.techniques
    device = local_device(settings.compute.device)
    search = None
    if settings.queries.black_box_queries is not None:
        _require_plain(job, world)
        # By name: who reads how training goes need not read how searching does.
        search = importlib.import_module("cloak_core.core.black_box")
    drawn = settings if search is None else search.search_settings(settings, len(job.detectors))
    sampler = Sampler(drawn, job.source, len(job.backgrounds))
    batcher = Batcher(drawn, sampler, job.backgrounds, pattern, device)
    first = torch.from_numpy(job.first).to(device)
    with contextlib.ExitStack() as stack:
        opened = open_run(out, job.config, pattern.cover, resume)
        run = world.on_rank0(lambda: stack.enter_context(opened)) or RunFolder(out)
        stop = stack.enter_context(stop_request(run.cancel, settings.run.max_seconds))
        objective = Objective(drawn, pattern, job.detectors, device, techniques)
        if search is None:
            optimizer = ColorOptimizer(settings.optimization, first, job.coloring)
            loop = TrainingLoop(settings, run, batcher, objective, optimizer, on_event, world)
        else:
            prior = None
            if job.query_prior:
                asked = Objective(drawn, pattern, job.query_prior, device, techniques)
                prior = search.QueryPrior(asked, pattern.centres)
            loop = search.Search(drawn, run, batcher, objective, first, on_event, world, pattern.centres, prior)
        result = loop.run_to_end(stop)
    for detector, record in zip(job.detectors, job.config["detectors"], strict=True):
        detector.verify(record["sha256"])
    return result


def _require_plain(job: TrainingJob, world: World) -> None:
    """Refuse what a search by questions does not do. InputError."""
    if world.size > 1:
        raise InputError("--black-box-queries: searches in one process")
    pattern, optimization = job.settings.pattern, job.settings.optimization
    is_plain = pattern.pattern == "free" and pattern.profile is None and optimization.octaves == 1
    if not is_plain or optimization.initial_share or job.coloring.is_restricted:
        refused = (
            "--colors-at-most, --pattern, --profile, --near, --octaves, --initial-share, or a --technique that projects"
        )
        raise InputError(f"--black-box-queries: free colours alone, without {refused}")
