"""Where experiments train and evaluate: each training and each evaluation is made once and found again by its content.

A run lives in OUT/runs/HASH, an evaluation in OUT/evaluations/HASH, the hash taken over everything that decides the
result. So experiments share them, and an interrupted set goes on where it stopped.
"""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from cloak_core.attack.events import OnEvent, read_events
from cloak_core.attack.run_config import FREE_SETTINGS, device_kind
from cloak_core.attack.settings import TrainSettings, make_settings, settings_record
from cloak_core.attack.training import train
from cloak_core.detectors.protocol import Detector, detector_record
from cloak_core.evaluation.controls import NATURAL, STANDARD
from cloak_core.evaluation.evaluate import make_stage
from cloak_core.evaluation.experiments.logos import chest_thighs
from cloak_core.evaluation.experiments.materials import Materials, backgrounds_record, bodies_record
from cloak_core.evaluation.experiments.options import QUICK_STEPS, Options
from cloak_core.evaluation.experiments.repeats import Repeats
from cloak_core.evaluation.inference import OnProgress, measure
from cloak_core.evaluation.measurement import Measurement, read_measurement
from cloak_core.evaluation.settings import EvaluateSettings
from cloak_core.evaluation.stage import Stage
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.colors import read_colors
from cloak_core.files.errors import InputError
from cloak_core.files.identity import TRAINING, code_hash, package_versions, sha256_arrays, sha256_record
from cloak_core.files.locks import lock
from cloak_core.files.reading import read_json
from cloak_core.files.writing import new_folder, write_json, written
from cloak_core.scene.logos.logo import Logo, make_logo

_log = logging.getLogger("cloak")
_MEASURING = ("controls", "cycles", "evaluate", "inference", "measurement", "precision", "settings", "stage")
MEASURING = (*TRAINING, *(f"evaluation/{name}.py" for name in _MEASURING))
"""The code that decides what an evaluation measures."""
PACKAGES = ("torch", "numpy", "numba", "pillow")
CONTROLS = (*STANDARD, *NATURAL)
SINGLE, MULTI = "0", "-10:10:5"
"""Training angles of the paper."""


class Interrupted(Exception):
    """A training was stopped in order; the same command goes on from there."""


@dataclass(frozen=True, eq=False)
class Trained:
    """Colours of one training."""

    colors: np.ndarray
    logo: Logo
    folder: Path
    seconds: float
    """Of the training, by the clock on the wall."""
    cpu_seconds: float
    """The processor's time, all threads: what counts where others work beside; nan where nobody measured it."""
    settings: TrainSettings = field(repr=False)


class Lab:
    """Trains and evaluates on some materials, remembering both in files."""

    def __init__(
        self, materials: Materials, options: Options, on_progress: Callable[[str], None] | None = None
    ) -> None:
        self.materials, self.options = materials, options
        self.tell = on_progress or (lambda message: _log.info("%s", message))
        """Takes a line of progress."""
        self.on_event: OnEvent | None = None
        """Hears what trainings log."""
        self.on_images: OnProgress | None = None
        """Hears how many images of an evaluation are done, and how many there are."""
        if len(options.steps) not in (0, 1, len(self.specs)):
            raise InputError(
                f"--steps: {len(options.steps)} numbers for {len(self.specs)} detectors; one for all or one for each"
            )

    @property
    def specs(self) -> tuple[str, ...]:
        """Specs of the detectors, in order."""
        return tuple(self.materials.detectors)

    @cached_property
    def _detector_records(self) -> dict[str, dict]:
        return {spec: detector_record(detector) for spec, detector in self.materials.detectors.items()}

    def _key(self, record: dict, code: Sequence[str]) -> str:
        """A short name for all that decides a result, and the code and the kind of device that compute it."""
        around = {"code": code_hash(*code), "packages": package_versions(*PACKAGES)}
        try:
            return sha256_record(record | around | {"device": device_kind(self.options.device)})[:16]
        except ValueError as error:
            raise InputError(f"settings: {error}") from None

    @property
    def angles(self) -> tuple[float, ...]:
        """The paper's test angles: 21 whole degrees in -10..10; every second one when quick."""
        return tuple(float(a) for a in range(-10, 11, 2 if self.options.quick else 1))

    # --- training

    def repeat(self, faces: np.ndarray, specs: Sequence[str], **changes: object) -> list[Trained]:
        """`train` once per seed."""
        return [self.train(faces, specs, seed=seed, **changes) for seed in self.options.seed_list]

    def chest_thighs(self, spec: str, **changes: object) -> list[Trained]:
        """`repeat` for the training bodies' chest + thighs against one detector."""
        return self.repeat(chest_thighs(self.materials.bodies), [spec], **changes)

    def train(
        self,
        faces: np.ndarray,
        specs: Sequence[str],
        *,
        bodies: Bodies | None = None,
        seed: int = 0,
        precision: str = "float32",
        **changes: object,
    ) -> Trained:
        """Colours for these faces against these detectors, run in this precision; `changes` are training settings."""
        bodies = bodies or self.materials.bodies
        settings = self.train_settings(seed, specs, **changes)
        logo = make_logo(bodies, faces)
        more = {} if precision == "float32" else {"precision": precision}
        key = self._train_key(settings, bodies, logo, specs, more)
        folder = self.options.out / "runs" / key
        with self._at(key):
            if not _is_done(folder):
                named = ", ".join(f"{k}={v}" for k, v in changes.items()) or "default settings"
                self.tell(f"training {key} ({named})")
                self._train_into(folder, settings, bodies, logo, specs, precision)
        colors = read_colors(folder / "colors.npy", len(logo))
        seconds = max((float(e.get("time", 0)) for e in read_events(folder / "events.jsonl")), default=math.nan)
        return Trained(colors, logo, folder, seconds, _cpu_seconds(folder), settings)

    def _train_into(
        self, folder: Path, settings: TrainSettings, bodies: Bodies, logo: Logo, specs: Sequence[str], precision: str
    ) -> None:
        chosen = [self.materials.detectors[spec] for spec in specs]
        with _precision(chosen, precision) as detectors, _clocked(folder):
            backgrounds, told = self.materials.backgrounds, self.on_event
            result = train(settings, bodies, logo, detectors, backgrounds, folder, resume=True, on_event=told)
        if result.stopped:
            raise Interrupted(f"{folder}: stopped at step {result.step}: {result.stopped}")

    @contextlib.contextmanager
    def _at(self, key: str) -> Iterator[None]:
        """Nobody else makes the thing of this name meanwhile; whoever does already is waited for, and then it is
        there."""
        folder = self.options.out / "locks"
        with written(folder):
            folder.mkdir(parents=True, exist_ok=True)
        with lock(folder / key, wait=True):
            yield

    def train_settings(self, seed: int = 0, specs: Sequence[str] = (), **changes: object) -> TrainSettings:
        """The options' preset and counts for these detectors (none: the first), with changes by name."""
        options = self.options
        values: dict[str, object] = {"seed": seed, "size": options.size, "device": options.device}
        if options.steps:
            by_spec = dict(zip(self.specs, options.steps * (len(self.specs) // len(options.steps)), strict=True))
            values["steps"] = max(by_spec[spec] for spec in specs or self.specs[:1])
        elif options.quick:
            values["steps"] = QUICK_STEPS
        if options.size < 416:
            values["translation"] = options.size // 8  # the presets' are meant for 416 pixels
        values |= {k: v for k, v in (("batch", options.batch), ("samples", options.samples)) if v is not None}
        return make_settings(**({"preset": options.preset} | values | changes))

    def steps(self, specs: Sequence[str] = (), **changes: object) -> int:
        """Updates of a training against these detectors (none: the first) with these changes."""
        return self.train_settings(specs=specs, **changes).total_steps(len(self.materials.backgrounds))

    def _train_key(self, settings: TrainSettings, bodies: Bodies, logo: Logo, specs: Sequence[str], more: dict) -> str:
        record = {k: v for k, v in settings_record(settings).items() if k not in FREE_SETTINGS}
        return self._key(
            {
                "settings": record,
                "bodies": bodies_record(bodies)["sha256"],
                "logo": sha256_arrays(logo.face_ids),
                "detectors": [self._detector_records[spec] for spec in specs],
                "operating_points": [self.materials.detectors[spec].operating_point for spec in specs],
                "backgrounds": backgrounds_record(self.materials.backgrounds),
            }
            | more,
            TRAINING,
        )

    # --- evaluation

    def evaluate(
        self,
        trained: Sequence[Trained],
        angles: Sequence[float],
        specs: Sequence[str] | None = None,
        *,
        bodies: Bodies | None = None,
        **changes: object,
    ) -> Repeats:
        """The trainings (repetitions of one thing) on the same unseen images, beside all controls."""
        bodies = bodies or self.materials.unseen
        settings = self.evaluate_settings(**changes)
        asked = (bodies, tuple(specs or self.specs), tuple(map(float, angles)), settings)
        made = (partial(self.stage, one, angles, settings, bodies) for one in trained)
        return Repeats([self.measured(stage, one, *asked) for stage, one in zip(made, trained, strict=True)])

    def evaluate_settings(self, **changes: object) -> EvaluateSettings:
        """The options' counts and all controls, with changes by name."""
        options = self.options
        settings = EvaluateSettings(
            images_per_view=options.test_images,
            size=options.size,
            samples=options.samples,
            controls=CONTROLS,
            shift=min(50, options.size // 8),
            seed=options.seed,
        )
        return replace(settings, **changes)

    def stage(
        self,
        trained: Trained,
        angles: Sequence[float],
        settings: EvaluateSettings,
        bodies: Bodies | None = None,
    ) -> Stage:
        """The images of an evaluation, ready to render."""
        bodies = bodies or self.materials.unseen
        logo = make_logo(bodies, trained.logo.face_ids)
        backgrounds = self.materials.unseen_backgrounds
        return make_stage(trained.colors, logo, bodies, backgrounds, self.materials.detectors, angles, settings)

    def measured(
        self,
        make: Callable[[], Stage],
        trained: Trained,
        bodies: Bodies,
        specs: tuple[str, ...],
        angles: tuple[float, ...],
        settings: EvaluateSettings,
        **more: object,
    ) -> Measurement:
        """What these detectors say of the stage that `make` makes, from the file where that was asked before.

        `more`: whatever else decides the images, by name.
        """
        logo = make_logo(bodies, trained.logo.face_ids)
        record = {
            "settings": asdict(settings),
            "angles": angles,
            "bodies": bodies_record(bodies)["sha256"],
            "logo": sha256_arrays(logo.face_ids, trained.colors),
            "detectors": [[spec, self._detector_records[spec]] for spec in specs],
            "backgrounds": backgrounds_record(self.materials.unseen_backgrounds),
        }
        key = self._key(record | more, MEASURING)
        folder = self.options.out / "evaluations" / key
        with self._at(key):
            if not (folder / "scores.npz").exists():
                self.tell(f"evaluating {trained.folder.name} as {key}")
                detectors = {spec: self.materials.detectors[spec] for spec in specs}
                measurement = measure(make(), detectors, settings, self.on_images)
                shown = {"run": trained.folder.name, "settings": asdict(settings), "angles": angles, "detectors": specs}
                with new_folder(folder) as temporary:
                    write_json(temporary / "config.json", shown | more)
                    measurement.save(temporary / "scores.npz")
        return read_measurement(folder / "scores.npz")


@contextlib.contextmanager
def _precision(detectors: Sequence[Detector], precision: str) -> Iterator[Sequence[Detector]]:
    """The detectors, run in this precision for a while."""
    before = [detector.precision for detector in detectors]
    try:
        for detector in detectors:
            detector.precision = precision
        yield detectors
    finally:
        for detector, old in zip(detectors, before, strict=True):
            detector.precision = old


@contextlib.contextmanager
def _clocked(folder: Path) -> Iterator[None]:
    """Adds the processor's time of what happens inside to the run's `cost.json`."""
    earlier = _cpu_seconds(folder) if (folder / "cost.json").exists() else 0.0
    started, known = time.process_time(), not folder.exists() or (folder / "cost.json").exists()
    try:
        yield
    finally:
        if known and folder.exists():  # of a run whose beginning nobody clocked the rest would tell nothing
            write_json(folder / "cost.json", {"cpu_seconds": round(earlier + time.process_time() - started, 2)})


def _cpu_seconds(folder: Path) -> float:
    path = folder / "cost.json"
    return float(read_json(path)["cpu_seconds"]) if path.exists() else math.nan


def times(trained: Sequence[Trained]) -> dict[str, float | None]:
    """Mean `seconds` by the clock on the wall and `cpu_seconds` of the processor, one decimal; None: not measured.

    The second hardly counts what others do on the machine.
    """
    mean = {name: float(np.mean([getattr(t, name) for t in trained])) for name in ("seconds", "cpu_seconds")}
    return {name: None if np.isnan(value) else round(value, 1) for name, value in mean.items()}


def _is_done(folder: Path) -> bool:
    """Whether a run ended by itself."""
    if not (folder / "colors.npy").exists():
        return False
    ends = [e for e in read_events(folder / "events.jsonl") if e.get("type") == "end"]
    return bool(ends) and ends[-1].get("outcome") == "done"
