"""Train and evaluate on one data split, once: a measurement lies in OUT/evaluations/KEY, a run in OUT/runs/KEY.

Each key is a hash of everything that decides the result, so several experiments share trainings and measurements.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int64

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.evaluate import measure_frozen
from cloak_core.core.evaluation.controls import LOGO, NATURAL, STANDARD
from cloak_core.core.evaluation.measure import OnProgress, kept_frozen, measure
from cloak_core.core.evaluation.renderer import EvaluationRenderer
from cloak_core.core.evaluation.results import Results, pool, read_results
from cloak_core.core.evaluation.settings import QUICK_STEPS, EvaluateSettings, StoreOptions, WearSettings
from cloak_core.core.logo import make_logo
from cloak_core.core.settings import TrainSettings, make_settings
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.writing import new_folder, write_json
from cloak_core.sources.photographs.fits import NOBODY, Fits, fit_people, people_identity
from cloak_core.sources.photographs.people import People
from cloak_core.sources.photographs.views import logo_positions
from cloak_core.studies.body_renderer import BodyRenderer
from cloak_core.studies.cloaked import Cloaked
from cloak_core.studies.data_split import DataSplit, backgrounds_record, bodies_record
from cloak_core.studies.evaluate import make_renderer
from cloak_core.studies.printed_cloth import PrintedCloth
from cloak_core.studies.report.words import short_name
from cloak_core.studies.training_store import Trained, Training, TrainingStore, content_key
from cloak_core.studies.wearing.clothes import Clothes, clothes_of, content_of
from cloak_core.studies.wearing.renderer import PeopleRenderer

MEASUREMENT_VERSION = 4
"""Raise it by one when the same colours and settings give other scores or boxes than before: after a change of the
drawn images, rendering, detectors, or of what is kept of their answers."""
CONTROLS = (*STANDARD, *NATURAL)


class RunStore(TrainingStore):
    """Train and evaluate on one data split, and keep the results in files."""

    def __init__(
        self, split: DataSplit, options: StoreOptions, on_progress: Callable[[str], None] | None = None
    ) -> None:
        """on_progress takes lines of progress. InputError: step counts that do not fit the detectors."""
        super().__init__(options.out, on_progress)
        self.split = split
        self.options = options
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
        """Train once per seed; arguments as in `train_faces`."""
        return [self.train_faces(faces, specs, seed=seed, **changes) for seed in self.options.seed_list]

    def train_faces(
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
        with _precision([self.split.detectors[spec] for spec in specs], precision) as detectors:
            training = Training(settings, bodies, logo, detectors, self.split.backgrounds, self._people)
            return self.train_once(training, self.folder(training), _training_words(specs, seed, changes))

    @cached_property
    def _people(self) -> Fits:
        """The split's people in photographs, fitted, to train on."""
        return NOBODY if self.split.people is None else fit_people(self.split.people)

    def untrained(
        self,
        colors: Float32[np.ndarray, "L 3"],
        faces: Int64[np.ndarray, " L"],
        folder: Path = Path("untrained"),
        cloth: PrintedCloth | None = None,
    ) -> Trained:
        """Take colours that were not trained here, to evaluate them; the folder's name is told in records.

        cloth: what the colours are the means of.
        """
        logo = make_logo(self.split.unseen, faces)
        return Trained(colors, logo, folder, math.nan, math.nan, self.train_settings(), cloth)

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
        if options.batch is not None:
            values["batch"] = options.batch
        if options.samples is not None:
            values["samples"] = options.samples
        return make_settings(**({"preset": options.preset} | values | changes))

    def steps(self, specs: Sequence[str] = (), **changes: object) -> int:
        """Count the updates of a training with these settings."""
        return self.train_settings(specs=specs, **changes).total_steps(len(self.split.backgrounds))

    # --- evaluation

    def measure_repetitions(
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
        settings = self.evaluate_settings(**changes)
        specs = tuple(specs or self.specs)
        bodies = bodies or self.split.unseen
        angles = tuple(map(float, angles))
        people = self.split.unseen_people
        more = {} if people is None else {"people": people_identity(people)}
        results = []
        for repetition in trained:
            make = partial(self.renderer, repetition, angles, settings, bodies if people is None else None)
            results.append(self.measure_once(make, repetition, bodies, specs, angles, settings, **more))
        return pool(results)

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
        backgrounds = self.split.unseen_backgrounds
        device = next(iter(self.split.detectors.values())).device
        if bodies is None and self.split.unseen_people is not None:
            position = logo_positions(trained.logo.topology, trained.logo.face_ids)
            worn = clothes_of(LOGO, position, trained.colors, trained.cloth)
            wear = WearSettings(size=settings.size)
            return PeopleRenderer(fit_people(self.split.unseen_people), [worn], backgrounds, wear, device)
        bodies = bodies or self.split.unseen
        cloaked = Cloaked(trained.colors, make_logo(bodies, trained.logo.face_ids), bodies, backgrounds, trained.cloth)
        return make_renderer(cloaked, angles, settings, device)

    def measure_once(
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
            "logo": trained.content,
            "detectors": [[spec, self._detector_records[spec]] for spec in specs],
            "operating_points": [self.split.detectors[spec].operating_point for spec in specs],
            "backgrounds": backgrounds_record(self.split.unseen_backgrounds),
            "measurement": MEASUREMENT_VERSION,
        }
        shown = {"run": trained.folder.name, "settings": asdict(settings), "angles": angles, "detectors": specs}
        detectors = {spec: self.split.detectors[spec] for spec in specs}
        look = lambda: measure_frozen(make(), detectors, settings, self.on_images)[0]
        return self._kept(record | more, shown | more, look)

    def measure_people(self, clothes: Sequence[Clothes], people: People, settings: WearSettings) -> Results:
        """Measure what all detectors say of people in photographs in these clothes and the controls, or find it."""
        record = {
            "settings": asdict(settings),
            "clothes": {one.name: content_of(one) for one in clothes},
            "people": people_identity(people),
            "detectors": [[spec, self._detector_records[spec]] for spec in self.specs],
            "operating_points": [self.split.detectors[spec].operating_point for spec in self.specs],
            "measurement": MEASUREMENT_VERSION,
        }

        def look() -> Results:
            device = self.split.detectors[self.specs[0]].device
            renderer = PeopleRenderer(fit_people(people), clothes, self.split.unseen_backgrounds, settings, device)
            told = {"batch": settings.batch, "on_progress": self.on_images}
            with kept_frozen(self.split.detectors):
                return measure(renderer, self.split.detectors, tuple(renderer.clothes), (), **told)

        shown = {"run": "people", "settings": asdict(settings), "clothes": list(record["clothes"])}
        shown |= {"detectors": self.specs}
        return self._kept(record, shown, look)

    def _kept(self, record: Mapping[str, object], shown: Mapping[str, object], look: Callable[[], Results]) -> Results:
        """Measure once: results are found again by the content of `record`; `shown` is kept beside them for people."""
        folder = self.out / "evaluations" / content_key(record, self.options.device)
        with self.locked(folder):
            if not (folder / "scores.npz").exists():
                self.tell(f"evaluating{' on people,' * ('people' in record)} by {_short(shown['detectors'])}")
                results = look()
                with new_folder(folder) as temporary:
                    write_json(temporary / "config.json", dict(shown))
                    results.save(temporary / "scores.npz")
        return read_results(folder / "scores.npz")

    @cached_property
    def _detector_records(self) -> dict[str, dict]:
        return {spec: detector_record(detector) for spec, detector in self.split.detectors.items()}


def _training_words(specs: Sequence[str], seed: int, changes: Mapping[str, object]) -> str:
    """Say what is trained: against what, and by which settings; a run that it begins with has no name for people."""
    settings = "".join(f", {name} {value}" for name, value in changes.items() if name not in ("init", "max_seconds"))
    return f"against {_short(specs)}{settings}, seed {seed}"


def _short(specs: Sequence[str]) -> str:
    return ", ".join(map(short_name, specs))


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
