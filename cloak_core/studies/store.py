"""Train and evaluate once: runs and measurements are kept in files and found again by their content.

A run lies in OUT/runs/KEY, a measurement in OUT/evaluations/KEY. The key is a hash of everything that decides the
result, so several experiments share trainings, and an interrupted set goes on where it stopped.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int64

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.evaluation.controls import LOGO, NATURAL, STANDARD
from cloak_core.core.evaluation.measure import OnProgress
from cloak_core.core.evaluation.renderer import BodyRenderer, EvaluationRenderer
from cloak_core.core.evaluation.results import Results, pool, read_results
from cloak_core.core.evaluation.settings import QUICK_STEPS, EvaluateSettings, StoreOptions, WearSettings
from cloak_core.core.events import OnEvent
from cloak_core.core.logo import Logo, make_logo
from cloak_core.core.run_config import FREE_SETTINGS, device_kind
from cloak_core.core.run_folder import read_start
from cloak_core.core.settings import TrainSettings, make_settings, settings_record
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.colors import read_colors
from cloak_core.files.errors import InputError, Stopped
from cloak_core.files.identity import package_versions, sha256_arrays, sha256_record
from cloak_core.files.locks import lock
from cloak_core.files.writing import new_folder, remove_leftovers, write_json, written
from cloak_core.sources.photographs.fits import fit_people, people_identity
from cloak_core.sources.photographs.views import logo_positions
from cloak_core.studies.cloaked import Cloaked
from cloak_core.studies.data_split import DataSplit, backgrounds_record, bodies_record
from cloak_core.studies.evaluate import make_renderer, measure_frozen
from cloak_core.studies.trained_run import clocked, cpu_seconds, read_history
from cloak_core.studies.trainings.training import train
from cloak_core.studies.wearing.clothes import LogoClothes
from cloak_core.studies.wearing.renderer import PeopleRenderer

_log = logging.getLogger("cloak")
TRAINING_VERSION = 3
"""Raise it by one when the same settings and inputs train other colours than before: after a change of sampling,
objective, optimizer, rendering, detectors or scenes. A change of words, speed or structure keeps every run."""
MEASUREMENT_VERSION = 2
"""Raise it by one when the same colours and settings give other scores or boxes than before: after a change of the
drawn images, rendering, detectors, or of what is kept of their answers."""
PACKAGES = ("torch", "numpy", "numba", "pillow")
CONTROLS = (*STANDARD, *NATURAL)


@dataclass(frozen=True, eq=False)
class Trained:
    """The colours of one training."""

    colors: Float32[np.ndarray, "L 3"]
    logo: Logo
    folder: Path
    seconds: float
    """Wall-clock time of the training."""
    cpu_seconds: float
    """Processor time of the training, all threads; nan where it was not measured."""
    settings: TrainSettings = field(repr=False)


class RunStore:
    """Train and evaluate on one data split, and keep the results in files."""

    def __init__(
        self, split: DataSplit, options: StoreOptions, on_progress: Callable[[str], None] | None = None
    ) -> None:
        """on_progress takes lines of progress. InputError: step counts that do not fit the detectors."""
        self.split, self.options = split, options
        self.tell = on_progress or (lambda message: _log.info("%s", message))
        self.on_event: OnEvent | None = None
        """Takes what trainings log."""
        self.on_images: OnProgress | None = None
        """Takes how many images of an evaluation are done, and how many there are."""
        if len(options.steps) not in (0, 1, len(self.specs)):
            raise InputError(
                f"--steps: {len(options.steps)} numbers for {len(self.specs)} detectors; one for all or one for each"
            )

    @property
    def specs(self) -> tuple[str, ...]:
        """Specs of the detectors, in order."""
        return tuple(self.split.detectors)

    def with_detectors(self, detectors: dict[str, Detector]) -> RunStore:
        """Make a store of the same folder with more detectors; every training then names its number of steps."""
        split = replace(self.split, detectors=self.split.detectors | detectors)
        return RunStore(split, replace(self.options, steps=()), self.tell)

    # --- training

    def train_repetitions(
        self, faces: Int64[np.ndarray, " L"], specs: Sequence[str], **changes: object
    ) -> list[Trained]:
        """Train once per seed; arguments as in `train`."""
        return [self.train(faces, specs, seed=seed, **changes) for seed in self.options.seed_list]

    def train(
        self,
        faces: Int64[np.ndarray, " L"],
        specs: Sequence[str],
        *,
        bodies: Bodies | None = None,
        seed: int = 0,
        precision: str = "float32",
        **changes: object,
    ) -> Trained:
        """Train colours for these faces against these detectors, or find them.

        bodies: the split's training bodies where none are given. precision: of the detectors. changes: training
        settings by name. Stopped: the training was stopped in order.
        """
        bodies = bodies or self.split.bodies
        settings = self.train_settings(seed, specs, **changes)
        logo = make_logo(bodies, faces)
        key = self._train_key(settings, bodies, logo, specs, {} if precision == "float32" else {"precision": precision})
        folder = self.options.out / "runs" / key
        with self._locked(key):
            if not _is_done(folder):
                named = ", ".join(f"{k}={v}" for k, v in changes.items()) or "default settings"
                self.tell(f"training {key} ({named})")
                self._train_into(folder, settings, bodies, logo, specs, precision)
        colors = read_colors(folder / "colors.npy", len(logo))
        return Trained(colors, logo, folder, read_history(folder).seconds, cpu_seconds(folder), settings)

    def untrained(
        self, colors: Float32[np.ndarray, "L 3"], faces: Int64[np.ndarray, " L"], folder: Path = Path("untrained")
    ) -> Trained:
        """Take colours that were not trained here, to evaluate them; the folder's name is told in records."""
        return Trained(colors, make_logo(self.split.unseen, faces), folder, math.nan, math.nan, self.train_settings())

    def _train_into(
        self, folder: Path, settings: TrainSettings, bodies: Bodies, logo: Logo, specs: Sequence[str], precision: str
    ) -> None:
        chosen = [self.split.detectors[spec] for spec in specs]
        with _precision(chosen, precision) as detectors, clocked(folder):
            backgrounds, on_event = self.split.backgrounds, self.on_event
            people = () if self.split.people is None else fit_people(self.split.people)
            heard = {"resume": True, "on_event": on_event, "people": people}
            result = train(settings, bodies, logo, detectors, backgrounds, folder, **heard)
        if result.stopped:
            raise Stopped(f"{folder}: stopped at step {result.step}: {result.stopped}")

    def train_settings(self, seed: int = 0, specs: Sequence[str] = (), **changes: object) -> TrainSettings:
        """Make the settings of a training from the options, with changes by name.

        specs: the detectors to train against, whose numbers of steps may differ; none: the first.
        """
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
        """Count the updates of a training with these settings."""
        return self.train_settings(specs=specs, **changes).total_steps(len(self.split.backgrounds))

    def _train_key(self, settings: TrainSettings, bodies: Bodies, logo: Logo, specs: Sequence[str], more: dict) -> str:
        record = {
            "settings": {k: v for k, v in settings_record(settings).items() if k not in FREE_SETTINGS},
            "bodies": bodies_record(bodies)["sha256"],
            "logo": sha256_arrays(logo.face_ids),
            "detectors": [self._detector_records[spec] for spec in specs],
            "operating_points": [self.split.detectors[spec].operating_point for spec in specs],
            "backgrounds": backgrounds_record(self.split.backgrounds),
        }
        if self.split.people is not None:
            record["people"] = people_identity(self.split.people)
        if settings.optimization.init is not None:
            record["start"] = sha256_arrays(read_start(Path(settings.optimization.init), logo))
        return self._key(record | more | {"training": TRAINING_VERSION})

    # --- evaluation

    def evaluate(
        self,
        trained: Sequence[Trained],
        angles: Sequence[float],
        specs: Sequence[str] | None = None,
        *,
        bodies: Bodies | None = None,
        **changes: object,
    ) -> Results:
        """Measure repetitions of one training on the same unseen images, beside controls, as one table.

        angles: azimuths in degrees. Where the split has people in photographs, they are what is seen, as they stand
        there. specs: the judging detectors, all where none are given. bodies: the split's unseen
        bodies where none are given. changes: evaluation settings by name.
        """
        settings, specs = self.evaluate_settings(**changes), tuple(specs or self.specs)
        bodies, angles, people = bodies or self.split.unseen, tuple(map(float, angles)), self.split.unseen_people
        more = {} if people is None else {"people": people_identity(people)}
        make = lambda one: partial(self.renderer, one, angles, settings, bodies if people is None else None)
        return pool([self.measured(make(one), one, bodies, specs, angles, settings, **more) for one in trained])

    def evaluate_settings(self, **changes: object) -> EvaluateSettings:
        """Make the settings of an evaluation from the options: all controls that there are, and changes by name."""
        options = self.options
        settings = EvaluateSettings(
            images_per_view=options.test_images,
            size=options.size,
            samples=options.samples,
            controls=CONTROLS if self.split.unseen_people is None else STANDARD,
            shift=min(50, options.size // 8),
            seed=options.seed,
        )
        return replace(settings, **changes)

    def renderer(
        self, trained: Trained, angles: Sequence[float], settings: EvaluateSettings, bodies: Bodies | None = None
    ) -> BodyRenderer | PeopleRenderer:
        """Make the renderer of an evaluation's images: these bodies, else unseen people, else unseen bodies."""
        backgrounds, device = self.split.unseen_backgrounds, next(iter(self.split.detectors.values())).device
        if bodies is None and self.split.unseen_people is not None:
            worn = LogoClothes(LOGO, logo_positions(trained.logo.topology, trained.logo.face_ids), trained.colors)
            how = WearSettings(size=settings.size)
            return PeopleRenderer(fit_people(self.split.unseen_people), [worn], backgrounds, how, device)
        bodies = bodies or self.split.unseen
        cloaked = Cloaked(trained.colors, make_logo(bodies, trained.logo.face_ids), bodies, backgrounds)
        return make_renderer(cloaked, angles, settings, device)

    def measured(
        self,
        make: Callable[[], EvaluationRenderer],
        trained: Trained,
        bodies: Bodies,
        specs: tuple[str, ...],
        angles: tuple[float, ...],
        settings: EvaluateSettings,
        **more: object,
    ) -> Results:
        """Measure what these detectors say of the images of the renderer that `make` makes, or find it.

        more: what else decides the images, by name.
        """
        record = {
            "settings": asdict(settings),
            "angles": angles,
            "bodies": bodies_record(bodies)["sha256"],
            "logo": sha256_arrays(trained.logo.face_ids, trained.colors),
            "detectors": [[spec, self._detector_records[spec]] for spec in specs],
            "operating_points": [self.split.detectors[spec].operating_point for spec in specs],
            "backgrounds": backgrounds_record(self.split.unseen_backgrounds),
            "measurement": MEASUREMENT_VERSION,
        }
        key = self._key(record | more)
        folder = self.options.out / "evaluations" / key
        with self._locked(key):
            if not (folder / "scores.npz").exists():
                self.tell(f"evaluating {trained.folder.name} as {key}")
                detectors = {spec: self.split.detectors[spec] for spec in specs}
                results, _ = measure_frozen(make(), detectors, settings, self.on_images)
                shown = {"run": trained.folder.name, "settings": asdict(settings), "angles": angles, "detectors": specs}
                with new_folder(folder) as temporary:
                    write_json(temporary / "config.json", shown | more)
                    results.save(temporary / "scores.npz")
        return read_results(folder / "scores.npz")

    # --- keys

    @cached_property
    def _detector_records(self) -> dict[str, dict]:
        return {spec: detector_record(detector) for spec, detector in self.split.detectors.items()}

    def _key(self, record: dict) -> str:
        """Name what a record decides, together with the packages and the kind of device that compute it."""
        around = {"packages": package_versions(*PACKAGES), "device": device_kind(self.options.device)}
        try:
            return sha256_record(record | around)[:16]
        except ValueError as error:
            raise InputError(f"settings: {error}") from None

    @contextlib.contextmanager
    def _locked(self, key: str) -> Iterator[None]:
        """Wait until no other process makes the result of this key, and keep others from it."""
        folder = self.options.out / "locks"
        with written(folder):
            folder.mkdir(parents=True, exist_ok=True)
        with lock(folder / key, wait=True):
            for kind in ("runs", "evaluations"):
                remove_leftovers(self.options.out / kind / key)
            yield


def training_times(trained: Sequence[Trained]) -> dict[str, float | None]:
    """Average `seconds` and `cpu_seconds` over repetitions, one decimal; None where they were not measured."""
    mean = {name: float(np.mean([getattr(t, name) for t in trained])) for name in ("seconds", "cpu_seconds")}
    return {name: None if np.isnan(value) else round(value, 1) for name, value in mean.items()}


@contextlib.contextmanager
def _precision(detectors: Sequence[Detector], precision: str) -> Iterator[Sequence[Detector]]:
    """Run the detectors in this precision for a while."""
    before = [detector.precision for detector in detectors]
    try:
        for detector in detectors:
            detector.precision = precision
        yield detectors
    finally:
        for detector, old in zip(detectors, before, strict=True):
            detector.precision = old


def _is_done(folder: Path) -> bool:
    """Tell whether a run ended by itself."""
    return (folder / "colors.npy").exists() and read_history(folder).outcome == "done"
