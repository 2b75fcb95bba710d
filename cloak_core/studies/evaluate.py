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
from typing import TYPE_CHECKING, ClassVar

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluate import Patterns, headline, identity
from cloak_core.core.evaluate import evaluate as measure
from cloak_core.core.evaluation import CLOTHING, LOGO, RESAMPLED
from cloak_core.core.evaluation.measure import OnProgress, check_asked
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.settings import EvaluateSettings, WearSettings
from cloak_core.core.events import read_events
from cloak_core.core.images import ImageSet
from cloak_core.core.pattern import Pattern
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.writing import new_folder, write_json
from cloak_core.patterns.controls import controls
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.studies.cycles import in_cycles
from cloak_core.studies.film import write_turntable
from cloak_core.studies.imagery import drawn_images, flat_views
from cloak_core.studies.report.pictures import Drawing, write_flat, write_pictures
from cloak_core.studies.report.plots import success_over_time
from cloak_core.studies.report.stored import FOLDER, PEOPLE_FOLDER, check_folder, read_evaluation
from cloak_core.studies.report.style import save_figure, style
from cloak_core.studies.trained_run import photographs_seen_in_training, seen_in_training, trained_against

if TYPE_CHECKING:
    from cloak_core.sources.photographs.crowd import Crowd

_log = logging.getLogger("cloak")


@dataclass(frozen=True, eq=False)
class Shown:
    """What is evaluated: images, what is worn in them, and what is known of it."""

    images: ImageSet
    patterns: Patterns
    circumstances: dict
    """Keys of the summary: settings, inputs, unseen, white_box, warnings."""
    draw_more: Callable[[Path, int, Mapping[str, Detector], float], dict] = lambda *_: {"flat": {}}
    """Draws further pictures into a folder, of a trial, with what detectors report above a threshold."""


@dataclass(frozen=True, eq=False)
class OnBodies:
    """Bodies before backgrounds, on whom a pattern is judged."""

    bodies: Bodies
    backgrounds: Backgrounds
    angles: Sequence[float]
    """Azimuths, degrees."""
    folder: ClassVar[str] = FOLDER
    """Name of the evaluation's folder inside a run."""
    curve: ClassVar[str] = "curve"
    """Name of the files inside a run that hold success over time."""

    def record(self, out: Path) -> dict:
        """Say what the result of a call holds beside the summary in `out`."""
        return {}

    def show(
        self,
        pattern: Pattern,
        detectors: Mapping[str, Detector],
        settings: EvaluateSettings,
        training: dict | None = None,
    ) -> Shown:
        """Make what is evaluated of a pattern.

        `training` tells what the colours were trained on (a run's config.json) and fills `unseen` and `white_box` (by
        detector, whether it was trained against). InputError: nobody to judge it, or the pattern is another mesh's.
        """
        bodies, backgrounds, angles = self.bodies, self.backgrounds, self.angles
        check_asked(detectors, angles)
        device = next(iter(detectors.values())).device
        names = dict.fromkeys((CLOTHING, *settings.controls))
        patterns = {LOGO: pattern} | controls(tuple(names), pattern, settings.seed, bodies)
        images = drawn_images(bodies, backgrounds, angles, settings, device, patterns.values())
        unseen, warnings = seen_in_training(training, bodies, backgrounds)
        inputs = {
            "bodies": list(images.body_names),
            "scene": bodies.name,
            "topology": bodies.topology,
            "backgrounds": len(backgrounds),
            "logo_faces": len(pattern.cover),
            "pattern": pattern.identity,
        }
        circumstances = {
            "cover": pattern.cover.name,
            "settings": asdict(settings) | {"angles": [float(a) for a in angles]},
            "inputs": inputs,
        }
        circumstances |= {"unseen": unseen, "white_box": trained_against(training, detectors), "warnings": warnings}

        def draw_more(folder: Path, trial: int, detectors: Mapping[str, Detector], threshold: float) -> dict:
            flat = flat_views(bodies, pattern, device=device)
            shown = {"flat": {side: write_flat(folder, side, rgba) for side, rgba in flat.items()}}
            turntable = folder / "turntable.gif"
            if settings.cycles is None and write_turntable(turntable, images, patterns, trial, detectors, threshold):
                shown["turntable"] = turntable.name
            return shown

        return Shown(images, patterns, circumstances, draw_more)


PEOPLE_SETTINGS = ("size", "threshold", "bare", "resamples", "batch", "seed")
"""The evaluation settings that decide figures of photographs."""


@dataclass(frozen=True, eq=False)
class OnPeople:
    """People in photographs, on whom a pattern is judged; all else as `OnBodies` has it."""

    crowd: Crowd
    backgrounds: Backgrounds
    bodies: ClassVar[None] = None
    folder: ClassVar[str] = PEOPLE_FOLDER
    curve: ClassVar[str] = "curve-people"

    def record(self, out: Path) -> dict:
        """See `OnBodies`."""
        return {"out": str(out)}

    def show(
        self,
        pattern: Pattern,
        detectors: Mapping[str, Detector],
        settings: EvaluateSettings,
        training: dict | None = None,
    ) -> Shown:
        """See `OnBodies`. Beside C6's keys the summary has people, photographs, left_out, and fit (means over fits)."""
        check_asked(detectors)
        worn = self.crowd.wearers([pattern])
        shown = worn.people
        framing = WearSettings(size=settings.size)
        # What dressing alone does is among the controls.
        names = dict.fromkeys((CLOTHING, *settings.controls, *([RESAMPLED] if settings.controls else [])))
        patterns = {LOGO: pattern} | controls(tuple(names), pattern, settings.seed)
        images = worn.images(self.backgrounds, framing, next(iter(detectors.values())).device)
        unseen, warnings = photographs_seen_in_training(training, self.crowd.pictures())
        counts = {"people": len(shown), "photographs": len(shown.photographs)}
        circumstances = counts | {
            "cover": pattern.cover.name,
            "left_out": shown.left_out,
            "fit": worn.quality(),
            "settings": {key: getattr(settings, key) for key in PEOPLE_SETTINGS}
            | {"context": framing.context, "controls": list(names)},
            "inputs": counts | {"backgrounds": len(self.backgrounds)},
            "unseen": unseen,
            "white_box": trained_against(training, detectors),
            "warnings": warnings,
        }
        return Shown(images, patterns, circumstances)


def evaluate(
    shown: Shown,
    detectors: dict[str, Detector],
    settings: EvaluateSettings,
    *,
    out: Path | None = None,
    on_progress: OnProgress | None = None,
) -> dict:
    """Measure attack success as contract C6 puts it, with every control on the same images.

    `operating_points` are the detectors' own thresholds, by spec; `operating_points_assumed` lists detectors with the
    usual threshold of their family, where nobody said one. `out` is a folder that takes the raw scores, pictures and
    the summary. Where it holds an evaluation of the same content, its summary is returned; any other one is replaced.
    InputError: a folder of something else.
    """
    for warning in shown.circumstances["warnings"]:
        _log.warning("%s", warning)
    images = shown.images
    if out is not None:
        check_folder(out)
    if settings.cycles is not None:
        if out is None:
            raise InputError("--cycles: frames are kept beside the evaluation: say where it goes (--out)")
        images = in_cycles(images, shown.patterns, out.with_name("cycles"), settings.cycles, on_progress)
    if out is not None and (out / "summary.json").exists():
        summary = _finished(out, identity(images, shown.patterns, detectors, settings))
        if summary is not None:
            _log.warning("%s: holds this very evaluation already: nothing is measured again", out)
            return summary
        _log.warning("%s: holds an evaluation already, which this one replaces (--out DIR keeps both)", out)
    summary, results = measure(images, shown.patterns, detectors, settings, shown.circumstances, on_progress)
    if out is not None:
        write_evaluation(out, summary, results, replace(shown, images=images), detectors)
    return summary


def _finished(folder: Path, content: str | None) -> dict | None:
    """Return the summary of a whole evaluation of this content; None where the folder holds another one."""
    try:
        summary = read_evaluation(folder).summary
    except InputError:  # damaged: it is replaced
        return None
    kept = summary.get("inputs")
    return summary if content and isinstance(kept, dict) and kept.get("content") == content else None


# --- the folder of an evaluation


def write_evaluation(
    folder: Path, summary: dict, results: Results, shown: Shown, detectors: dict[str, Detector]
) -> None:
    """Write everything at once; an earlier evaluation there is replaced when the new one is complete."""
    folder = check_folder(folder)
    fresh = folder.with_name(f"{folder.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    with new_folder(fresh) as temporary:
        (temporary / "pictures").mkdir()
        threshold = summary["settings"]["threshold"]
        place = temporary / "pictures"
        pictures = write_pictures(Drawing(place, shown.images, shown.patterns, detectors), results)
        pictures |= shown.draw_more(place, pictures["controls"]["trial"], detectors, threshold)
        write_json(temporary / "pictures.json", pictures)
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
    snapshots = {int(m[1]): path for path in (run / "snapshots").glob("*.npy") if (m := _NAME.fullmatch(path.name))}
    if not snapshots:
        raise InputError(f"{run}: has no snapshots (cloak train --snapshot-every N keeps them)")
    events = read_events(run / "events.jsonl") if (run / "events.jsonl").exists() else []
    step_events = {event["step"]: event for event in events if event.get("type") == "step"}
    bare = replace(settings, controls=(), bare=1)
    rows = []
    for step, path in sorted(snapshots.items()):
        event = step_events.get(step, {})
        row = {"step": step, "seconds": event.get("time")} | {k: event[k] for k in ("queries",) if k in event}
        summary = judge(path, bare)
        rows.append(row | {"detectors": {spec: headline(x["logo"]) for spec, x in summary["detectors"].items()}})
    write_json(run / f"{name}.json", {"rows": rows})
    with style():
        save_figure(success_over_time(rows), run / name)
    return rows
