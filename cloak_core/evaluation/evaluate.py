"""How well a cloak works: attack success on bodies, backgrounds and angles, beside controls on the same images."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from cloak_core.detectors.protocol import Detector, state_hash
from cloak_core.evaluation.cycles import first_trials, in_cycles
from cloak_core.evaluation.evaluation_folder import check_folder, write_evaluation
from cloak_core.evaluation.inference import OnProgress, all_controls, measure
from cloak_core.evaluation.measurement import draw_trials
from cloak_core.evaluation.provenance import seen_in_training, trained_against
from cloak_core.evaluation.rates import summarize
from cloak_core.evaluation.settings import EvaluateSettings
from cloak_core.evaluation.stage import Stage
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.render.view_files import view_files
from cloak_core.render.views import ViewBank
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.logos.logo import Logo

_log = logging.getLogger("cloak")


def evaluate(
    colors: Float32[np.ndarray, "L 3"],
    logo: Logo,
    bodies: Bodies,
    backgrounds: Backgrounds,
    detectors: dict[str, Detector],
    angles: Sequence[float],
    settings: EvaluateSettings | None = None,
    *,
    training: dict | None = None,
    out: Path | None = None,
    on_progress: OnProgress | None = None,
) -> dict:
    """Attack success as contract C6 puts it, with every control on the same images.

    `training` tells what the colours were trained on (a run's config.json) and fills `unseen` and `white_box` (by
    detector, whether it was trained against). `operating_points` are the detectors' own thresholds, by spec; those in
    `operating_points_assumed` nobody said, they are what the family usually runs at. `out` is a folder that takes the
    raw scores, pictures and the summary (replacing an earlier evaluation's).
    InputError: a scene of another topology (both hashes), colours for another logo.
    """
    settings = settings or EvaluateSettings()
    check_inputs(colors, logo, bodies, backgrounds, detectors, angles)
    if out is not None:
        check_folder(out)
    unseen, warnings = seen_in_training(training, bodies, backgrounds)
    for warning in warnings:
        _log.warning("%s", warning)
    stage = make_stage(colors, logo, bodies, backgrounds, detectors, angles, settings)
    if settings.cycles is not None:
        stage = _in_cycles(stage, settings, out, on_progress)
    hashes = {spec: state_hash(detector) for spec, detector in detectors.items()}
    measurement = measure(stage, detectors, settings, on_progress)
    for spec, detector in detectors.items():
        detector.verify(hashes[spec])
    seen = {"unseen": unseen, "white_box": trained_against(training, detectors), "warnings": warnings}
    points = {spec: detector.operating_point for spec, detector in detectors.items()}
    assumed = [spec for spec, detector in detectors.items() if detector.operating_point_assumed]
    seen |= {"n": len(stage.trials), "operating_points": points, "operating_points_assumed": assumed}
    summary = summarize(measurement, settings.threshold, settings.resamples, points) | seen
    summary |= _circumstances(stage, hashes, settings, angles)
    if out is not None:
        write_evaluation(out, summary, measurement, stage, detectors)
    return summary


def _in_cycles(stage: Stage, settings: EvaluateSettings, out: Path | None, on_progress: OnProgress | None) -> Stage:
    """The stage as Cycles renders it; frames stand beside the evaluation, and are rendered once."""
    if out is None:
        raise InputError("--cycles: frames are kept beside the evaluation: say where it goes (--out)")
    controls, said = all_controls(settings), itertools.count(1)
    every = len(first_trials(stage.trials)) * len(controls)

    def tell(_: str) -> None:
        if on_progress is not None:
            on_progress(next(said), every)

    return in_cycles(stage, controls, out.with_name("cycles"), settings.cycles, tell)


def _circumstances(stage: Stage, hashes: dict[str, str], settings: EvaluateSettings, angles: Sequence[float]) -> dict:
    """The summary's `settings` and `inputs`: how, and of what, it was made."""
    inputs = {
        "bodies": list(stage.bodies.names),
        "scene": stage.bodies.name,
        "topology": stage.bodies.topology,
        "backgrounds": len(stage.backdrops),
        "logo_faces": len(stage.logo.face_ids),
        "colors": sha256_arrays(stage.colors),
        "detector_hashes": hashes,
    }
    return {"settings": asdict(settings) | {"angles": [float(a) for a in angles]}, "inputs": inputs}


def check_inputs(
    colors: np.ndarray, logo: Logo, bodies: Bodies, backgrounds: Backgrounds, detectors: dict, angles: Sequence[float]
) -> None:
    """InputError for what does not fit together."""
    if logo.topology != bodies.topology:
        raise InputError(
            f"scene '{bodies.name}': the logo was made for topology {logo.topology}, this scene has {bodies.topology}"
        )
    if len(colors) != len(logo.face_ids):
        raise InputError(f"colours for {len(colors)} faces, but the logo has {len(logo.face_ids)}")
    if not len(backgrounds):
        raise InputError("no background to evaluate on")
    if not detectors:
        raise InputError("--detector: none given")
    if not len(angles):
        raise InputError("--angles: none given")


def make_stage(
    colors: np.ndarray,
    logo: Logo,
    bodies: Bodies,
    backgrounds: Backgrounds,
    detectors: dict[str, Detector],
    angles: Sequence[float],
    settings: EvaluateSettings,
) -> Stage:
    """Draw the trials and make ready to render them."""
    trials = draw_trials(bodies.pose_count, angles, len(backgrounds), bodies.outfit_count, settings)
    device = next(iter(detectors.values())).device
    bank = ViewBank(bodies, samples=settings.samples, device=device, files=view_files())
    return Stage(colors, logo, bodies, backgrounds, trials, settings.camera, bank, settings.seed)
