"""How well a cloak works: attack success on bodies, backgrounds and angles, beside controls on the same images.

An evaluation is kept in a folder: summary.json, scores.npz, pictures.json and pictures/.
"""

from __future__ import annotations

import logging
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluation.measure import OnProgress, all_controls, check_asked, kept_frozen, measure
from cloak_core.core.evaluation.renderer import BodyRenderer, EvaluationRenderer
from cloak_core.core.evaluation.results import Results, read_results
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.statistics import summarize
from cloak_core.core.evaluation.trials import draw_trials
from cloak_core.core.events import read_events
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.colors import read_colors
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.files.reading import read_json
from cloak_core.files.writing import new_folder, write_json
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.sources.bodies.view_files import view_files
from cloak_core.studies.cloaked import Cloaked
from cloak_core.studies.cycles import in_cycles
from cloak_core.studies.film import write_turntable
from cloak_core.studies.report.pictures import write_pictures
from cloak_core.studies.report.plots import success_over_time
from cloak_core.studies.report.style import save_figure, style
from cloak_core.studies.trained_run import seen_in_training, trained_against

_log = logging.getLogger("cloak")


def evaluate(
    cloaked: Cloaked,
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
    InputError: nothing to judge or nobody to judge it, a folder of something else.
    """
    settings = settings or EvaluateSettings()
    check_asked(detectors, angles)
    if out is not None:
        check_folder(out)
    unseen, warnings = seen_in_training(training, cloaked.bodies, cloaked.backgrounds)
    for warning in warnings:
        _log.warning("%s", warning)
    renderer = make_renderer(cloaked, angles, settings, next(iter(detectors.values())).device)
    if settings.cycles is not None:
        if out is None:
            raise InputError("--cycles: frames are kept beside the evaluation: say where it goes (--out)")
        frames = out.with_name("cycles")
        renderer = in_cycles(renderer, all_controls(settings), frames, settings.cycles, on_progress)
    inputs = {
        "bodies": list(renderer.body_names),
        "scene": cloaked.bodies.name,
        "topology": cloaked.bodies.topology,
        "backgrounds": len(cloaked.backgrounds),
        "logo_faces": len(cloaked.logo.face_ids),
        "colors": sha256_arrays(cloaked.colors),
    }
    circumstances = {"settings": asdict(settings) | {"angles": [float(a) for a in angles]}, "inputs": inputs}
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
    # Of more backgrounds than are looked at, a draw by the seed.
    order = np.random.default_rng([settings.seed, 0xBA2E]).permutation(len(renderer.background_names))
    bare, controls = np.sort(order[: settings.bare]), all_controls(settings)
    with kept_frozen(detectors) as hashes:
        results = measure(renderer, detectors, controls, bare, batch=settings.batch, on_progress=on_progress)
    return results, hashes


def detector_facts(detectors: Mapping[str, Detector]) -> dict:
    """Return the summary's `operating_points`, by spec, and which of them are assumed."""
    points = {spec: detector.operating_point for spec, detector in detectors.items()}
    assumed = [spec for spec, detector in detectors.items() if detector.operating_point_assumed]
    return {"operating_points": points, "operating_points_assumed": assumed}


def make_renderer(
    cloaked: Cloaked, angles: Sequence[float], settings: EvaluateSettings, device: torch.device | str = "cpu"
) -> BodyRenderer:
    """Draw the trials and make ready to render them."""
    bodies = cloaked.bodies
    trials = draw_trials(bodies.pose_count, angles, len(cloaked.backgrounds), bodies.outfit_count, settings)
    view_cache = ViewCache(bodies, RenderSettings.of(settings, device=device, files=view_files()))
    return BodyRenderer(cloaked, trials, settings.camera, view_cache, settings.seed)


def headline(record: Mapping[str, object]) -> dict:
    """Select success at both thresholds, intervals and count of one S of contract C6; None for what it lacks."""
    return {key: record.get(key) for key in ("success", "success_own", "ci95", "ci95_own", "n")}


# --- the folder of an evaluation

FOLDER = "evaluation"
"""Name of the folder inside a run."""


@dataclass(frozen=True)
class StoredEvaluation:
    """An evaluation read back."""

    folder: Path
    summary: dict
    pictures: dict
    results: Results


def check_folder(folder: Path) -> Path:
    """Refuse a folder that holds something that is no evaluation (InputError); asked before the work begins, too."""
    folder = Path(folder)
    if folder.exists() and not (folder.is_dir() and ((folder / "summary.json").exists() or not any(folder.iterdir()))):
        raise InputError(f"{folder}: holds something that is no evaluation, and is left alone")
    return folder


def read_evaluation(folder: Path) -> StoredEvaluation:
    """Read what `write_evaluation` wrote; InputError names what is missing or damaged."""
    return StoredEvaluation(
        folder=folder,
        summary=read_json(folder / "summary.json"),
        pictures=read_json(folder / "pictures.json"),
        results=read_results(folder / "scores.npz"),
    )


def write_evaluation(
    folder: Path, summary: dict, results: Results, renderer: EvaluationRenderer, detectors: dict[str, Detector]
) -> None:
    """Write everything at once; an earlier evaluation there is replaced when the new one is complete."""
    folder = check_folder(folder)
    fresh = folder.with_name(f"{folder.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    with new_folder(fresh) as temporary:
        (temporary / "pictures").mkdir()
        threshold = summary["settings"]["threshold"]
        shown = write_pictures(temporary / "pictures", renderer, results, detectors, threshold)
        turntable, trial = temporary / "pictures/turntable.gif", shown["controls"]["trial"]
        ours = type(renderer) is BodyRenderer  # a turntable is our render, of a body
        if ours and write_turntable(turntable, renderer, trial, detectors, threshold, len(results.controls)):
            shown["turntable"] = turntable.name
        write_json(temporary / "pictures.json", shown)
        results.save(temporary / "scores.npz")
        write_json(temporary / "summary.json", summary)
    # Renames only: a reader never meets half of an evaluation, and a crash in between loses none.
    old = folder.with_name(f"{folder.name}.old")
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        folder.rename(old)
    fresh.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


# --- success over time

_NAME = re.compile(r"step-(\d{8,})\.npy")


def over_time(
    run: Path,
    cloaked: Cloaked,
    detectors: dict[str, Detector],
    angles: Sequence[float],
    settings: EvaluateSettings,
    on_progress: OnProgress | None = None,
) -> list[dict]:
    """Measure every snapshot of a run on the same images; write RUN/curve.json, .png and .svg.

    A row each: {"step", "seconds", "queries" (of a search), "detectors": {SPEC: {"success", "success_own", "ci95",
    "ci95_own", "n"}}}. InputError: the run kept none (`cloak train --snapshot-every`).
    """
    found = {int(m[1]): path for path in (run / "snapshots").glob("*.npy") if (m := _NAME.fullmatch(path.name))}
    if not found:
        raise InputError(f"{run}: has no snapshots (cloak train --snapshot-every N keeps them)")
    events = read_events(run / "events.jsonl") if (run / "events.jsonl").exists() else []
    told = {event["step"]: event for event in events if event.get("type") == "step"}
    bare = replace(settings, controls=(), bare=1)
    rows = []
    for step, path in sorted(found.items()):
        event = told.get(step, {})
        row = {"step": step, "seconds": event.get("time")} | {k: event[k] for k in ("queries",) if k in event}
        snapshot = replace(cloaked, colors=read_colors(path, len(cloaked.logo)))
        summary = evaluate(snapshot, detectors, angles, bare, on_progress=on_progress)
        rows.append(row | {"detectors": {spec: headline(x["logo"]) for spec, x in summary["detectors"].items()}})
    write_json(run / "curve.json", {"rows": rows})
    with style():
        save_figure(success_over_time(rows), run / "curve")
    return rows
