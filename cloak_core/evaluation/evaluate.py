"""How well a cloak works: attack success on bodies, backgrounds and angles, beside controls on the same images."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from cloak_core.detectors.protocol import Detector, state_hash
from cloak_core.evaluation.cycles import in_cycles
from cloak_core.evaluation.evaluation_folder import check_folder, write_evaluation
from cloak_core.evaluation.measure import OnProgress, all_controls, bare_indices, measure
from cloak_core.evaluation.provenance import seen_in_training, trained_against
from cloak_core.evaluation.renderer import BodyRenderer, EvaluationRenderer, check_inputs
from cloak_core.evaluation.results import Results
from cloak_core.evaluation.settings import EvaluateSettings
from cloak_core.evaluation.statistics import summarize
from cloak_core.evaluation.trials import draw_trials
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.render.settings import RenderSettings
from cloak_core.render.view_cache import ViewCache
from cloak_core.render.view_files import view_files
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
    """Measure attack success as contract C6 puts it, with every control on the same images.

    `training` tells what the colours were trained on (a run's config.json) and fills `unseen` and `white_box` (by
    detector, whether it was trained against). `operating_points` are the detectors' own thresholds, by spec;
    `operating_points_assumed` lists detectors with the usual threshold of their family, where nobody said one. `out` is
    a folder that takes the raw scores, pictures and the summary (replacing an earlier evaluation's).
    InputError: a scene of another topology (both hashes), colours for another logo.
    """
    settings = settings or EvaluateSettings()
    check_inputs(colors, logo, bodies, backgrounds, detectors, angles)
    if out is not None:
        check_folder(out)
    unseen, warnings = seen_in_training(training, bodies, backgrounds)
    for warning in warnings:
        _log.warning("%s", warning)
    renderer = make_renderer(colors, logo, bodies, backgrounds, detectors, angles, settings)
    if settings.cycles is not None:
        if out is None:
            raise InputError("--cycles: frames are kept beside the evaluation: say where it goes (--out)")
        frames = out.with_name("cycles")
        renderer = in_cycles(renderer, all_controls(settings), frames, settings.cycles, on_progress)
    circumstances = _circumstances(renderer, settings, angles)
    circumstances |= {"unseen": unseen, "white_box": trained_against(training, detectors), "warnings": warnings}
    return evaluate_renderer(renderer, detectors, settings, circumstances, out=out, on_progress=on_progress)


def evaluate_renderer(
    renderer: EvaluationRenderer,
    detectors: dict[str, Detector],
    settings: EvaluateSettings,
    circumstances: Mapping[str, object],
    *,
    out: Path | None = None,
    on_progress: OnProgress | None = None,
) -> dict:
    """Measure the renderer's trials and count: `summarize`, `detector_facts` and the circumstances in one record.

    circumstances: more keys of the summary; `settings` and `inputs` (which gets the detectors' hashes) are among them.
    """
    results, hashes = measure_frozen(renderer, detectors, settings, on_progress)
    summary = summarize(results, settings.threshold, settings.resamples)
    summary |= {"n": len(renderer.trials)} | detector_facts(detectors) | dict(circumstances)
    summary["inputs"] = summary["inputs"] | {"detector_hashes": hashes}
    if out is not None:
        write_evaluation(out, summary, results, renderer, detectors)
    return summary


def measure_frozen(
    renderer: EvaluationRenderer,
    detectors: dict[str, Detector],
    settings: EvaluateSettings,
    on_progress: OnProgress | None = None,
) -> tuple[Results, dict[str, str]]:
    """Measure under the settings' controls and return the detectors' hashes, which the evaluation must not change."""
    hashes = {spec: state_hash(detector) for spec, detector in detectors.items()}
    bare = bare_indices(renderer, settings)
    controls = all_controls(settings)
    results = measure(renderer, detectors, controls, bare, batch=settings.batch, on_progress=on_progress)
    for spec, detector in detectors.items():
        detector.verify(hashes[spec])
    return results, hashes


def detector_facts(detectors: Mapping[str, Detector]) -> dict:
    """Return the summary's `operating_points`, by spec, and which of them are assumed."""
    points = {spec: detector.operating_point for spec, detector in detectors.items()}
    assumed = [spec for spec, detector in detectors.items() if detector.operating_point_assumed]
    return {"operating_points": points, "operating_points_assumed": assumed}


def _circumstances(renderer: BodyRenderer, settings: EvaluateSettings, angles: Sequence[float]) -> dict:
    """Record how and from what the summary was made: its `settings` and `inputs`."""
    inputs = {
        "bodies": list(renderer.body_names),
        "scene": renderer.bodies.name,
        "topology": renderer.bodies.topology,
        "backgrounds": len(renderer.backdrops),
        "logo_faces": len(renderer.logo.face_ids),
        "colors": sha256_arrays(renderer.colors),
    }
    return {"settings": asdict(settings) | {"angles": [float(a) for a in angles]}, "inputs": inputs}


def make_renderer(
    colors: np.ndarray,
    logo: Logo,
    bodies: Bodies,
    backgrounds: Backgrounds,
    detectors: Mapping[str, Detector],
    angles: Sequence[float],
    settings: EvaluateSettings,
) -> BodyRenderer:
    """Draw the trials and make ready to render them."""
    trials = draw_trials(bodies.pose_count, angles, len(backgrounds), bodies.outfit_count, settings)
    device = next(iter(detectors.values())).device
    view_cache = ViewCache(bodies, RenderSettings.of(settings, device=device, files=view_files()))
    return BodyRenderer(colors, logo, bodies, backgrounds, trials, settings.camera, view_cache, settings.seed)
