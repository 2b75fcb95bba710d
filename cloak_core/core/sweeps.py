"""Sweeps: a training for every combination of a grid of settings, resumable, done here or by a cluster.

    DIR/runs/NAME/          run folders, named by what the grid gives them and a hash of everything that was asked for
    DIR/results/NAME.json   what came of each; written when it is done, so that it is not done again
    DIR/sweep.json, .md     all results so far

One process hands the runs out (`jobs`): to itself, one after the other, or to Ray. A run whose process died goes on
from its checkpoint.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import itertools
import json
import logging
import math
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.events import OnEvent, read_events
from cloak_core.core.logo import Logo, make_logo
from cloak_core.core.run_config import check_same, run_config
from cloak_core.core.settings import TrainSettings, merge, settings_from_record, settings_record
from cloak_core.core.settings.components import ComputeSettings
from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.face_lists import face_ids, read_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.locks import lock
from cloak_core.files.reading import read_json, read_toml
from cloak_core.files.writing import write_json, write_text, written
from cloak_core.jobs.job import Executor, Job, Tell, hand_out
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.studies.trainings.training import train

MOST_RUNS = 200_000
INPUTS = ("scene", "logo", "detector", "backgrounds")
"""What a grid may name beside settings."""
CONTENT = ("topology", "scene", "logo", "detectors", "backgrounds")
"""Of a run's configuration: what the files named in a grid may have changed in, and the grid does not show."""
FIGURES = ("loss", "disappearance", "tv", "nps", "success")
"""Of training, each the mean over a run's last tenth."""
TABLE_SECONDS = 60.0
"""Between writes of the table while runs go on; whoever ran the sweep writes it at the end."""
_log = logging.getLogger("cloak")
Prepare = Callable[[ComputeSettings], object]


@dataclasses.dataclass(frozen=True)
class SweepRun:
    """One combination."""

    varied: dict[str, object]
    """What the grid gives it."""
    scene: str
    logo: str
    backgrounds: str
    detectors: tuple[str, ...]
    settings: TrainSettings

    @property
    def name(self) -> str:
        """Of its folder: readable, and different for whatever differs."""
        record = {key: value for key, value in vars(self).items() if key != "varied"}
        record["settings"] = settings_record(self.settings)
        digest = hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()[:8]
        words = re.sub(r"[^\w.,=+-]+", "_", self.label.replace(", ", ","))
        return f"{words[:80]}-{digest}"

    @property
    def label(self) -> str:
        """For people."""
        return ", ".join(f"{key}={_text(value)}" for key, value in self.varied.items())


# --- the grid --------------------------------------------------------------------------------------------------------


def read_grid(path: str | Path, changes: Mapping[str, object] | None = None) -> list[SweepRun]:
    """Read the runs of a grid file: every combination of the lists in [grid], over [base], in the file's order.

    [base] and [grid] take the settings of `cloak train` by name, and scene, logo, detector, backgrounds, as on the
    command line. In [grid] each name has a list of values; an entry of `detector` may itself be a list, of detectors
    to be trained against at once. `changes` replace what [base] says. InputError names the file and the key.
    """
    path = Path(path)
    record = read_toml(path)
    for name in record:
        if name not in ("base", "grid") or not isinstance(record[name], dict):
            raise InputError(f"{path}: '{name}' is neither the table [base] nor [grid]")
    base, grid = (_keys(record.get(part, {}), path) for part in ("base", "grid"))
    base |= changes or {}
    if not grid:
        raise InputError(f"{path}: no [grid] to sweep over")
    for key, values in grid.items():
        if key in base:
            raise InputError(f"{path}: '{key}' stands in [base] and in [grid]")
        if not isinstance(values, list) or not values:
            raise InputError(f"{path}: [grid] {key}: a list of values is needed, such as [1, 2]")
        counts = Counter(map(_hashable, values))
        twice = [value for value in values if counts[_hashable(value)] > 1]
        if twice:
            raise InputError(f"{path}: [grid] {key}: {twice[0]!r} stands there twice")
    count = math.prod(map(len, grid.values()))
    if count > MOST_RUNS:
        raise InputError(f"{path}: {count} runs, more than {MOST_RUNS}")
    combinations = (dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values()))
    return [_run(base, varied, path) for varied in combinations]


def _keys(table: dict, path: Path) -> dict:
    changed = {key.replace("-", "_"): value for key, value in table.items()}
    if len(changed) < len(table):
        raise InputError(f"{path}: a name stands there twice, once with - and once with _")
    return changed


def _run(base: dict, varied: dict, path: Path) -> SweepRun:
    base, varied_settings = dict(base), dict(varied)
    inputs = {"backgrounds": "procedural:train", "detector": "builtin"}
    inputs |= {key: table.pop(key) for table in (base, varied_settings) for key in INPUTS if key in table}
    for key in INPUTS:
        if key not in inputs:
            raise InputError(f"{path}: {key} is missing (in [base] or [grid])")
    specs = inputs.pop("detector")
    specs = [specs] if isinstance(specs, str) else specs
    for key, value in [*inputs.items(), *(("detector", spec) for spec in (specs if isinstance(specs, list) else [0]))]:
        if not isinstance(value, str) or not value:
            raise InputError(f"{path}: {key}: {value!r} is not text")
    if not specs:
        raise InputError(f"{path}: detector: none given")
    try:
        settings = settings_from_record(merge(base, varied_settings))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return SweepRun(varied=varied, detectors=tuple(specs), settings=settings, **inputs)


def _hashable(value: object) -> object:
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def _text(value: object) -> str:
    return "+".join(map(_text, value)) if isinstance(value, list) else str(value)


# --- running it ------------------------------------------------------------------------------------------------------


_scene, _backgrounds, _detector = map(cache, (load_scene, load_backgrounds, load_detector))
"""Opened once in a process."""


def open_run(run: SweepRun) -> tuple[Bodies, Logo, list[Detector], Backgrounds]:
    """Open bodies, logo, detectors and backgrounds of a run. InputError names what cannot be opened."""
    bodies = _scene(run.scene)
    logo = make_logo(bodies, face_ids(read_face_list(run.logo, bodies), bodies))
    detectors = [_detector(spec, device=run.settings.compute.device) for spec in run.detectors]
    return bodies, logo, detectors, _backgrounds(run.backgrounds)


def train_run(run: SweepRun, folder: Path, prepare: Prepare | None, on_event: OnEvent | None = None) -> dict:
    """Train one, or go on with it; returns what is recorded of it, or `{"stopped": why}`."""
    if prepare:
        prepare(run.settings.compute)
    inputs = {"scene": run.scene, "logo": run.logo, "backgrounds": run.backgrounds}
    how = {"resume": True, "on_event": on_event, "inputs": inputs, "alone": True}
    result = train(run.settings, *open_run(run), folder, **how)
    if result.stopped and result.stopped != "time budget":  # which is a run's own
        return {"stopped": f"stopped in run {run.label}, at step {result.step}: {result.stopped}"}
    return result.record() | {"out": f"runs/{run.name}"} | _figures(folder)


class Sweep:
    """The runs of a grid in a folder. `run` does what is left of them."""

    def __init__(self, runs: Sequence[SweepRun], out: str | Path) -> None:
        self.runs, self.out = tuple(runs), Path(out)

    def run(
        self,
        tell: Tell = _log.info,
        on_event: OnEvent | None = None,
        prepare: Prepare | None = None,
        executor: Executor | None = None,
        gpus: float = 1.0,
    ) -> str:
        """Train what has no result yet; returns why it stopped early, "" when every run has ended.

        A run that fails (bad input, a loss that is not finite) is recorded with its message, and the others go on; the
        next sweep tries it again. `prepare` is called where a run is trained, before it; `on_event` hears runs that are
        trained here. `executor`: who trains (None: this process, in order); `gpus`: of one, or a share of one, for each
        run on a GPU. InputError before anything is trained: something in the grid cannot be opened, is not what runs
        that are done were made of, or somebody else is at this folder.
        """
        self._check_inputs()
        with written(self.out):
            for folder in ("runs", "results"):
                (self.out / folder).mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as stack:
            try:
                stack.enter_context(lock(self.out / ".lock"))
            except BlockingIOError:
                raise InputError(f"{self.out}: another sweep is at it; many at once are --ray's business") from None
            return self._hand_out(executor, tell, None if executor else on_event, prepare, gpus)

    def results(self) -> list[dict]:
        """Read what came of the runs that have ended, in the grid's order; those without an end are missing."""
        found = [self._result_path(run) for run in self.runs]
        return [read_json(path) for path in found if path.exists()]

    def write_results(self) -> dict:
        """Write sweep.json and sweep.md; returns the former."""
        with written(self.out):
            results = self.results()
            record = {"runs": len(self.runs), "done": sum("error" not in r for r in results), "results": results}
            write_json(self.out / "sweep.json", record)
            write_text(self.out / "sweep.md", "\n".join(table(results)) + "\n")
        return record

    def _hand_out(
        self, executor: Executor | None, tell: Tell, on_event: OnEvent | None, prepare: Prepare | None, gpus: float
    ) -> str:
        left = [run for run in self.runs if not self._is_done(run)]
        jobs = {self._job(run, on_event, prepare, gpus): run for run in left}
        shown = time.monotonic()
        with contextlib.closing(hand_out(executor, list(jobs), tell, "run")) as outcomes:
            for outcome in outcomes:
                run, record = jobs[outcome.job], outcome.result or {"error": outcome.error}
                if "stopped" in record:
                    return record["stopped"]
                write_json(self._result_path(run), {"name": run.name, "varied": run.varied} | record)
                # The table reads every result: of many short runs it must not be written after each.
                if time.monotonic() - shown > TABLE_SECONDS:
                    self.write_results()
                    shown = time.monotonic()
        return ""

    def _job(self, run: SweepRun, on_event: OnEvent | None, prepare: Prepare | None, gpus: float) -> Job:
        arguments = {"run": run, "folder": self.out / "runs" / run.name, "prepare": prepare, "on_event": on_event}
        compute = run.settings.compute
        resources = {"cores": compute.threads or 1, "gpus": 0.0 if compute.device == "cpu" else gpus}
        return Job(run.label, train_run, arguments, **resources)

    def _check_inputs(self) -> None:
        """Check all inputs. InputError: one cannot be opened, or a run is done whose inputs held something else."""
        known: dict[tuple, dict] = {}
        opened: dict[tuple, tuple] = {}
        for run in self.runs:
            # Of a hundred thousand runs most differ in settings alone.
            inputs = (run.scene, run.logo, run.backgrounds, run.detectors, run.settings.compute.device)
            if inputs not in opened:
                opened[inputs] = open_run(run)
            config = self.out / "runs" / run.name / "config.json"
            if self._result_path(run).exists() and config.exists():
                if inputs not in known:
                    known[inputs] = run_config(run.settings, *opened[inputs], {})
                check_same(read_json(config), known[inputs], config.parent, CONTENT)

    def _is_done(self, run: SweepRun) -> bool:
        path = self._result_path(run)
        return path.exists() and "error" not in read_json(path)

    def _result_path(self, run: SweepRun) -> Path:
        return self.out / "results" / f"{run.name}.json"


def _figures(folder: Path) -> dict:
    """Average the last tenth of a run's steps; add what was held out last told."""
    events = read_events(folder / "events.jsonl")
    steps = [e for e in events if e.get("type") == "step" and all(isinstance(e.get(k), (int, float)) for k in FIGURES)]
    last = steps[-max(1, len(steps) // 10) :]
    figures = {key: round(sum(event[key] for event in last) / len(last), 6) for key in FIGURES} if last else {}
    held = [e for e in events if e.get("type") == "held_out" and e.get("step") == e.get("best_step")]
    if held:
        figures["held_out"] = {key: held[-1].get(key) for key in ("step", "disappearance", "success")}
    return figures


def table(results: Sequence[dict]) -> list[str]:
    """Write the results as lines of a Markdown table."""
    varied = list(dict.fromkeys(key for result in results for key in result["varied"]))
    held = any("held_out" in result for result in results)
    heads = [*varied, "steps", "seconds", "loss", "success", *(["held-out success"] if held else []), "run"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for result in results:
        cells = [_text(result["varied"].get(key, "")) for key in varied]
        if "error" in result:
            cells += [*[""] * (len(heads) - len(varied) - 1), f"failed: {result['error']}"]
        else:
            cells += [str(result["step"]), f"{result['seconds']:.0f}"]
            cells += [f"{result[key]:.4f}" if key in result else "" for key in ("loss", "success")]
            cells += [f"{result['held_out']['success']:.4f}" if "held_out" in result else ""] if held else []
            cells += [result["out"]]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return lines
