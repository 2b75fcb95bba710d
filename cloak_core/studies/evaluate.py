"""How well a cloak works: attack success on bodies, backgrounds and angles, beside controls on the same images.

An evaluation is kept in a folder: summary.json, scores.npz, pictures.json and pictures/.
"""

from __future__ import annotations

import logging
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluate import content_hash, headline, measure_and_count
from cloak_core.core.evaluation.measure import OnProgress, all_controls, check_asked
from cloak_core.core.evaluation.renderer import EvaluationRenderer
from cloak_core.core.evaluation.results import Results, read_results
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.evaluation.trials import draw_trials
from cloak_core.core.events import read_events
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays, sha256_record
from cloak_core.files.reading import read_json
from cloak_core.files.writing import new_folder, write_json
from cloak_core.sources.bodies.view_cache import ViewCache
from cloak_core.studies.body_renderer import BodyRenderer
from cloak_core.studies.cloaked import Cloaked
from cloak_core.studies.cycles import in_cycles
from cloak_core.studies.film import write_turntable
from cloak_core.studies.report.pictures import write_pictures
from cloak_core.studies.report.plots import success_over_time
from cloak_core.studies.report.stored import check_stored
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
    shown = [cloaked.bodies.identity, sha256_arrays(cloaked.logo.face_ids), cloaked.backgrounds.identities()]
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
    if cloaked.cloth is not None:
        inputs["cloth"] = sha256_arrays(cloaked.cloth.colors, np.array(cloaked.cloth.cloth.metres))
    if settings.cycles is None:  # nobody knows what decides Blender's frames
        inputs["identity"] = sha256_record(shown)
    circumstances = {"settings": asdict(settings) | {"angles": [float(a) for a in angles]}, "inputs": inputs}
    circumstances |= {"unseen": unseen, "white_box": trained_against(training, detectors), "warnings": warnings}
    return evaluate_renderer(renderer, detectors, settings, circumstances, out=out, on_progress=on_progress)


def evaluate_renderer(
    renderer: EvaluationRenderer,
    detectors: dict[str, Detector],
    settings: EvaluateSettings,
    circumstances: Mapping[str, object],
    *,
    controls: Sequence[str] | None = None,
    out: Path | None = None,
    on_progress: OnProgress | None = None,
) -> dict:
    """Measure the renderer's trials and count: `summarize`, `detector_facts` and the circumstances in one record.

    circumstances: more keys of the summary; `settings` and `inputs` (which gets the detectors' hashes) are among them.
    controls: see `measure_frozen`. Where `out` holds an evaluation of the same content, its summary is returned; any
    other one is replaced.
    """
    content = content_hash(detectors, circumstances)
    if out is not None and (out / "summary.json").exists():
        summary = _finished(out, content)
        if summary is not None:
            _log.warning("%s: holds this very evaluation already: nothing is measured again", out)
            return summary
        _log.warning("%s: holds an evaluation already, which this one replaces (--out DIR keeps both)", out)
    summary, results = measure_and_count(renderer, detectors, settings, circumstances, controls, on_progress)
    if content:
        summary["inputs"] |= {"content": content}
    if out is not None:
        write_evaluation(out, summary, results, renderer, detectors)
    return summary


def _finished(folder: Path, content: str | None) -> dict | None:
    """Return the summary of a whole evaluation of this content; None where the folder holds another one."""
    try:
        summary = read_evaluation(folder).summary
    except InputError:  # damaged: it is replaced
        return None
    kept = summary.get("inputs")
    return summary if content and isinstance(kept, dict) and kept.get("content") == content else None


def make_renderer(
    cloaked: Cloaked, angles: Sequence[float], settings: EvaluateSettings, device: torch.device | str = "cpu"
) -> BodyRenderer:
    """Draw the trials and make ready to render them."""
    bodies = cloaked.bodies
    trials = draw_trials(bodies.pose_count, angles, len(cloaked.backgrounds), bodies.outfit_count, settings)
    render = RenderSettings.of(settings, device=device)
    view_cache = ViewCache(bodies, render, on_cloth=cloaked.cloth is not None)
    return BodyRenderer(cloaked, trials, settings.camera, view_cache, settings.seed)


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
    known = (folder / "summary.json").exists() or is_earlier_on_people(folder)
    if folder.exists() and not (folder.is_dir() and (known or not any(folder.iterdir()))):
        raise InputError(f"{folder}: holds something that is no evaluation, and is left alone")
    return folder


def is_earlier_on_people(folder: Path) -> bool:
    """Tell whether a folder holds a run's evaluation on photographs as earlier versions wrote it (wear.json)."""
    path = folder / "wear.json"
    # What `cloak wear` writes says nothing of a training.
    return path.is_file() and "white_box" in read_json(path)


def read_evaluation(folder: Path) -> StoredEvaluation:
    """Read what `write_evaluation` wrote; InputError names what is missing, damaged or of another type."""
    stored = StoredEvaluation(
        folder=folder,
        summary=read_json(folder / "summary.json"),
        pictures=read_json(folder / "pictures.json"),
        results=read_results(folder / "scores.npz"),
    )
    check_stored(folder, stored.summary, stored.pictures, stored.results)
    return stored


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
    run: Path, judge: Callable[[Path, EvaluateSettings], dict], settings: EvaluateSettings, name: str = "curve"
) -> list[dict]:
    """Measure every snapshot of a run on the same images; write RUN/NAME.json, .png and .svg.

    judge: measures the colours of a file. A row each: {"step", "seconds", "queries" (of a search), "detectors": {SPEC:
    {"success", "success_own", "ci95", "ci95_own", "n"}}}. InputError: the run kept none (`cloak train
    --snapshot-every`).
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
        summary = judge(path, bare)
        rows.append(row | {"detectors": {spec: headline(x["logo"]) for spec, x in summary["detectors"].items()}})
    write_json(run / f"{name}.json", {"rows": rows})
    with style():
        save_figure(success_over_time(rows), run / name)
    return rows
