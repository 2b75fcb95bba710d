"""Sweeps: a training for every combination of a grid of settings, resumable, done here or by a cluster.

    GRID.toml               [base], what all runs share, and [grid], lists of values for what varies
    DIR/runs/NAME/          run folders of a `TrainingStore`: what the grid varies, and the hash of their content
    DIR/results/NAME.json   what came of each; written when it is done, so that it is not done again
    DIR/sweep.json, .md     all results so far

One process hands the runs out (`jobs`): to itself, one after the other, or to Ray. A run whose process died goes on
from its checkpoint.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import math
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.events import OnEvent, read_events
from cloak_core.core.logo import Logo, make_logo
from cloak_core.core.settings import TrainSettings, merge, settings_from_record
from cloak_core.core.settings.components import ComputeSettings
from cloak_core.detectors.loading import load_detector
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.face_lists import face_ids, read_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json, read_toml
from cloak_core.files.specs import require_named
from cloak_core.files.writing import lock, write_json, write_text, written
from cloak_core.jobs.job import Executor, Job, Tell, hand_out, resources
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.studies.training_store import Training, TrainingStore

MOST_RUNS = 200_000
INPUTS = ("scene", "logo", "detector", "backgrounds")
"""What a grid may name beside settings."""
FIGURES = ("loss", "disappearance", "tv", "nps", "success")
"""Of training, each the mean over a run's last tenth."""
TABLE_SECONDS = 60.0
"""Between writes of the table while runs go on; whoever ran the sweep writes it at the end."""
_log = logging.getLogger("cloak")
_NAME = re.compile(r"(.*-)?[0-9a-f]{16}")
"""Of results; those of earlier versions were not named by content."""
Prepare = Callable[[ComputeSettings], object]


@dataclass(frozen=True)
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
    def label(self) -> str:
        """For people."""
        return ", ".join(f"{key}={words(value)}" for key, value in self.varied.items())


def read_grid(
    path: str | Path, changes: Mapping[str, object] | None = None, named: Sequence[str] = ()
) -> list[SweepRun]:
    """Read the runs of a grid file: every combination of the lists in [grid], over [base], in the file's order.

    [base] and [grid] take the settings of `cloak train` by name, and scene, logo, detector, backgrounds, as on the
    command line. In [grid] each name has a list of values; an entry of `detector` may itself be a list, of detectors
    to be trained against at once. `changes` replace what [base] says; of its detectors only those `named` here may run
    code or ask the network. InputError names the file and the key.
    """
    path = Path(path)
    record = read_toml(path)
    for name in record:
        if name not in ("base", "grid") or not isinstance(record[name], dict):
            raise InputError(f"{path}: '{name}' is neither the table [base] nor [grid]")
    base = _keys(record.get("base", {}), path) | dict(changes or {})
    grid = _keys(record.get("grid", {}), path)
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
    runs = [_run(base, varied, path) for varied in combinations]
    require_named((spec for run in runs for spec in run.detectors), path, named)
    return runs


def _keys(table: dict, path: Path) -> dict:
    changed = {key.replace("-", "_"): value for key, value in table.items()}
    if len(changed) < len(table):
        raise InputError(f"{path}: a name stands there twice, once with - and once with _")
    return changed


def _run(base: dict, varied: dict, path: Path) -> SweepRun:
    named = {"backgrounds": "procedural:train", "detector": "builtin"} | base | varied
    for key in INPUTS:
        if key not in named:
            raise InputError(f"{path}: {key} is missing (in [base] or [grid])")
    inputs = {key: named[key] for key in INPUTS}
    specs = inputs.pop("detector")
    specs = specs if isinstance(specs, list) else [specs]
    if not specs:
        raise InputError(f"{path}: detector: none given")
    for key, value in [*inputs.items(), *(("detector", spec) for spec in specs)]:
        if not isinstance(value, str) or not value:
            raise InputError(f"{path}: {key}: {value!r} is not text")
    try:
        layers = ({key: value for key, value in table.items() if key not in INPUTS} for table in (base, varied))
        settings = settings_from_record(merge(*layers))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return SweepRun(varied=varied, detectors=tuple(specs), settings=settings, **inputs)


def _hashable(value: object) -> object:
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def words(value: object) -> str:
    """Write a value of a grid for people."""
    return "+".join(map(words, value)) if isinstance(value, list) else str(value)


# Each is opened once in a process.
_scene = cache(load_scene)
_backgrounds = cache(load_backgrounds)
_detector = cache(load_detector)


def open_run(run: SweepRun) -> tuple[Bodies, Logo, list[Detector], Backgrounds]:
    """Open bodies, logo, detectors and backgrounds of a run. InputError names what cannot be opened."""
    bodies = _scene(run.scene)
    logo = make_logo(bodies, face_ids(read_face_list(run.logo, bodies), bodies))
    detectors = [_detector(spec, device=run.settings.compute.device) for spec in run.detectors]
    return bodies, logo, detectors, _backgrounds(run.backgrounds)


def train_run(run: SweepRun, folder: Path, prepare: Prepare | None, on_event: OnEvent | None = None) -> dict:
    """Train one into OUT/runs/NAME, or go on with it.

    Returns what is recorded of it, or `{"stopped": why}`.
    """
    if prepare:
        prepare(run.settings.compute)
    store = TrainingStore(folder.parents[1], alone=True)
    store.on_event = on_event
    inputs = {"scene": run.scene, "logo": run.logo, "backgrounds": run.backgrounds}
    result = store.go_on(Training(run.settings, *open_run(run), inputs=inputs), folder)
    if result.stopped and result.stopped != "time budget":  # which is a run's own
        return {"stopped": f"stopped in run {run.label}, at step {result.step}: {result.stopped}"}
    events = read_events(folder / "events.jsonl")
    steps = [e for e in events if e.get("type") == "step" and all(isinstance(e.get(k), (int, float)) for k in FIGURES)]
    last = steps[-max(1, len(steps) // 10) :]
    means = {key: round(sum(event[key] for event in last) / len(last), 6) for key in FIGURES} if last else {}
    return result.record() | {"out": f"runs/{folder.name}"} | means


class Sweep:
    """The runs of a grid in a folder. `run` does what is left of them."""

    def __init__(self, runs: Sequence[SweepRun], out: str | Path) -> None:
        self.runs = tuple(runs)
        self.out = Path(out)

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
        run on a GPU. InputError before anything is trained: something in the grid cannot be opened, the folder is of an
        earlier version, or somebody else is at it.
        """
        if any(not _NAME.fullmatch(path.stem) for path in (self.out / "results").glob("*.json")):
            old = "holds the results of a sweep by an earlier version, which sweep.md lists"
            raise InputError(f"{self.out}: {old}; choose another --out")
        jobs = {}
        for run, folder in zip(self.runs, self.folders, strict=True):
            result, compute = self._result(folder), run.settings.compute
            if result and "error" not in result:
                continue
            arguments = {"run": run, "folder": folder, "prepare": prepare, "on_event": None if executor else on_event}
            job = Job(run.label, train_run, arguments, **resources(compute.threads, compute.device, gpus))
            jobs[job] = run, folder
        with written(self.out):
            for name in ("runs", "results"):
                (self.out / name).mkdir(parents=True, exist_ok=True)
        tell(f"{len(jobs)} of {len(self.runs)} runs to train")
        busy = f"{self.out}: another sweep is at it; many at once are --ray's business"
        shown = time.monotonic()
        outcomes = hand_out(executor, list(jobs), tell, "run")
        with lock(self.out / ".lock", busy=busy), contextlib.closing(outcomes):
            for outcome in outcomes:
                run, folder = jobs[outcome.job]
                record = outcome.result or {"error": outcome.error}
                if "stopped" in record:
                    return record["stopped"]
                write_json(self._result_path(folder), {"name": folder.name, "varied": run.varied} | record)
                # The table reads every result: of many short runs it must not be written after each.
                if time.monotonic() - shown > TABLE_SECONDS:
                    self.write_results()
                    shown = time.monotonic()
        return ""

    @cached_property
    def folders(self) -> tuple[Path, ...]:
        """The run folder of each run, named by its content. InputError: something in the grid cannot be opened."""
        store = TrainingStore(self.out)
        opened: dict[tuple, tuple] = {}
        folders = []
        for run in self.runs:
            # Of a hundred thousand runs most differ in settings alone.
            inputs = (run.scene, run.logo, run.backgrounds, run.detectors, run.settings.compute.device)
            if inputs not in opened:
                opened[inputs] = open_run(run)
            label = re.sub(r"[^\w.,=+-]+", "_", run.label.replace(", ", ","))[:80]
            folders.append(store.folder(Training(run.settings, *opened[inputs]), label))
        return tuple(folders)

    def results(self) -> list[dict]:
        """Read what came of the runs that have ended, in the grid's order; those without an end are missing."""
        return [result for folder in self.folders if (result := self._result(folder))]

    def write_results(self) -> dict:
        """Write sweep.json and sweep.md; returns the former."""
        with written(self.out):
            results = self.results()
            record = {"runs": len(self.runs), "done": sum("error" not in r for r in results), "results": results}
            write_json(self.out / "sweep.json", record)
            write_text(self.out / "sweep.md", "\n".join(table(results)) + "\n")
        return record

    def _result_path(self, folder: Path) -> Path:
        return self.out / "results" / f"{folder.name}.json"

    def _result(self, folder: Path) -> dict:
        """Read what came of a run; {} before it has ended."""
        path = self._result_path(folder)
        return read_json(path) if path.exists() else {}


def table(results: Sequence[dict]) -> list[str]:
    """Write the results as lines of a Markdown table."""
    varied = list(dict.fromkeys(key for result in results for key in result["varied"]))
    heads = [*varied, "steps", "seconds", "loss", "success", "run"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for result in results:
        cells = [words(result["varied"].get(key, "")) for key in varied]
        if "error" in result:
            cells += [*[""] * (len(heads) - len(varied) - 1), f"failed: {result['error']}"]
        else:
            cells += [str(result["step"]), f"{result['seconds']:.0f}"]
            cells += [f"{result[key]:.4f}" if key in result else "" for key in ("loss", "success")]
            cells += [result["out"]]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return lines
