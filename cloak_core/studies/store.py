"""Train and evaluate on one data split, once: a measurement lies in OUT/evaluations/KEY, a run in OUT/runs/KEY.

Each key is a hash of everything that decides the result, so several experiments share trainings and measurements.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.core.evaluate import Patterns, identity, measure_frozen
from cloak_core.core.evaluation import CLOTHING, LOGO, RESAMPLED, STANDARD
from cloak_core.core.evaluation.measure import OnProgress
from cloak_core.core.evaluation.results import Results, pool, read_results
from cloak_core.core.evaluation.settings import QUICK_STEPS, EvaluateSettings, StoreOptions, WearSettings
from cloak_core.core.images import ImageSet, Indices
from cloak_core.core.logo import make_logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings import TrainSettings, make_settings
from cloak_core.core.source import NOBODY, Cast
from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.files.writing import new_folder, write_json
from cloak_core.patterns.controls import OwnClothing, controls
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.studies.imagery import drawn_images
from cloak_core.studies.opening import clothes_cover
from cloak_core.studies.report.words import short_name
from cloak_core.studies.trained_run import EMBEDDED
from cloak_core.studies.training_store import Trained, Training, TrainingStore, content_key
from cloak_core.studies.trainings.run_record import scene_counts


@dataclass(frozen=True, eq=False)
class DataSplit:
    """Bodies of one topology and backgrounds, for training and unseen; detectors by their specs."""

    bodies: Bodies
    unseen: Bodies
    backgrounds: Backgrounds
    unseen_backgrounds: Backgrounds
    detectors: dict[str, Detector]
    people: Cast = NOBODY
    """In photographs: where there are any, training sees them beside the bodies, and `unseen_people` judge."""
    unseen_people: Cast = NOBODY

    def __post_init__(self) -> None:
        if self.bodies.topology != self.unseen.topology:
            raise InputError(
                f"scene '{self.unseen.name}': topology {self.unseen.topology}, but training has {self.bodies.topology}"
            )
        if not self.detectors:
            raise InputError("--detector: none given")

    def record(self) -> dict:
        """Describe the split for a configuration: names, counts and content hashes."""
        bodies = {"bodies": self.bodies, "unseen": self.unseen}
        backgrounds = {"backgrounds": self.backgrounds, "unseen_backgrounds": self.unseen_backgrounds}
        record = {name: scene_counts(each) | {"sha256": each.identity} for name, each in bodies.items()}
        for name, each in backgrounds.items():
            record[name] = {"count": len(each), "sha256": sha256_record(each.identities())}
        record["detectors"] = {spec: sha256_record(detector_record(d)) for spec, d in self.detectors.items()}
        return record | self.people.summary("people") | self.unseen_people.summary("unseen_people")


def open_data_split(
    detectors: dict[str, Detector],
    *,
    scene: str = "sample",
    unseen: str | None = None,
    backgrounds: str = "procedural",
    unseen_backgrounds: str | None = None,
    people: Cast = NOBODY,
) -> DataSplit:
    """Open scenes and backgrounds by spec and split them for these detectors.

    Without `unseen`, every second body of `scene` and every second outfit is kept from training; without
    `unseen_backgrounds`, every second background; of `people` in photographs, those of every second photograph.
    Embedded scenes and backgrounds have unseen parts of their own.
    InputError: there is only one body or background to split.
    """
    if unseen_backgrounds is not None:
        behind = load_backgrounds(backgrounds), load_backgrounds(unseen_backgrounds)
    elif backgrounds == "procedural":
        behind = load_backgrounds("procedural:train"), load_backgrounds("procedural:test")
    else:
        every = load_backgrounds(backgrounds)
        if len(every) < 2:
            raise InputError(f"{backgrounds}: one background cannot be both trained on and unseen")
        behind = every.split(2, 0), every.split(2, 1)
    return DataSplit(*_open_bodies(scene, unseen), *behind, detectors, *people.halves())


def _open_bodies(scene: str, unseen: str | None) -> tuple[Bodies, Bodies]:
    if unseen is not None:
        return load_scene(scene), load_scene(unseen)
    if scene in EMBEDDED:
        trained = load_scene(f"{scene}:train")
        tested = load_scene(f"{scene}:unseen")
    else:
        bodies = load_scene(scene)
        if bodies.pose_count < 2:
            raise InputError(f"{scene}: one body cannot be both trained on and unseen; name other bodies with --unseen")
        trained = bodies.select_poses(range(0, bodies.pose_count, 2))
        tested = bodies.select_poses(range(1, bodies.pose_count, 2))
    return _every_second_outfit(trained, 0), _every_second_outfit(tested, 1)


def _every_second_outfit(bodies: Bodies, first: int) -> Bodies:
    """Keep every second outfit, beginning with number `first`; a single outfit stays."""
    if bodies.outfit_count == 1:
        return bodies
    textures = bodies.outfit_textures[first::2]
    return replace(
        bodies, face_colors=bodies.face_colors[first::2], outfit_textures=textures, recorded_topology=bodies.topology
    )


PEOPLE_CONTROLS = (*STANDARD, RESAMPLED)


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
        **changes: object,
    ) -> Trained:
        """Train colours for these faces against these detectors, or find them.

        bodies: the split's training bodies where none are given. changes: training settings by name. Stopped: the
        training was stopped in order.
        """
        bodies = bodies or self.split.bodies
        settings = self.train_settings(seed, specs, **changes)
        logo = make_logo(bodies, faces)
        detectors = [self.split.detectors[spec] for spec in specs]
        training = Training(settings, bodies, logo, detectors, self.split.backgrounds, self.split.people)
        # A run that it begins with has no name for people.
        described = "".join(
            f", {name} {value}" for name, value in changes.items() if name not in ("init", "max_seconds")
        )
        return self.train_once(training, self.folder(training), f"against {_short(specs)}{described}, seed {seed}")

    def untrained(self, pattern: Pattern, folder: Path = Path("untrained")) -> Trained:
        """Take a pattern that was not trained here, to evaluate it; the folder's name is told in records."""
        return Trained(pattern, folder, math.nan, math.nan, self.train_settings())

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
        detectors = {spec: self.split.detectors[spec] for spec in specs or self.specs}
        results = []
        for repetition in trained:
            images, patterns = self.shown(repetition.pattern, angles, settings, bodies)
            results.append(self.measure_once(images, patterns, detectors, settings, repetition.folder.name))
        return pool(results)

    def evaluate_settings(self, **changes: object) -> EvaluateSettings:
        """Make the settings of an evaluation from the options: all controls that there are, and changes by name."""
        options = self.options
        settings = EvaluateSettings(
            images_per_view=options.test_images,
            size=options.size,
            samples=options.samples,
            controls=(*STANDARD, *self.split.unseen_people.natural),
            shift=min(50, options.size // 8),
            seed=options.seed,
        )
        return replace(settings, **changes)

    def shown(
        self, pattern: Pattern, angles: Sequence[float], settings: EvaluateSettings, bodies: Bodies | None = None
    ) -> tuple[ImageSet, Patterns]:
        """Make the images of an evaluation, and what is worn in them: these bodies, else unseen people, else bodies."""
        backgrounds = self.split.unseen_backgrounds
        device = next(iter(self.split.detectors.values())).device
        names = tuple(dict.fromkeys((CLOTHING, *settings.controls)))
        if bodies is None and self.split.unseen_people:
            shown = self.split.unseen_people.images(backgrounds, WearSettings(size=settings.size), device)
            return shown, {LOGO: pattern} | controls(names, pattern, settings.seed)
        bodies = bodies or self.split.unseen
        patterns = {LOGO: pattern} | controls(names, pattern, settings.seed, bodies)
        return drawn_images(
            bodies, backgrounds, list(map(float, angles)), settings, device, patterns.values()
        ), patterns

    def measure_once(
        self,
        images: ImageSet,
        patterns: Patterns,
        detectors: dict[str, Detector],
        settings: EvaluateSettings | WearSettings,
        name: str,
        bare: Indices | None = None,
    ) -> Results:
        """Measure what these detectors say of these images, or find it: results are kept by their content.

        name: of what is judged, which is kept beside them for people. bare: see `measure_frozen`.
        """
        content = identity(images, patterns, detectors, settings)
        if content is None:
            return measure_frozen(images, patterns, detectors, settings, self.on_images, None, bare)[0]
        folder = self.out / "evaluations" / content_key({"evaluation": content}, self.options.device)
        with self.locked(folder):
            if not (folder / "scores.npz").exists():
                self.tell(f"evaluating {name} by {_short(list(detectors))}")
                results, _ = measure_frozen(images, patterns, detectors, settings, self.on_images, None, bare)
                shown = {"run": name, "settings": asdict(settings), "detectors": list(detectors)}
                with new_folder(folder) as temporary:
                    write_json(temporary / "config.json", shown | {"worn": list(patterns)})
                    results.save(temporary / "scores.npz")
        return read_results(folder / "scores.npz")

    def measure_people(self, worn: Patterns, people: Cast, settings: WearSettings, logo: str | None = None) -> Results:
        """Measure what all detectors say of people in photographs in these patterns and the controls, or find it.

        logo: what the controls cover (`clothes_cover`).
        """
        detectors = self.split.detectors
        device = detectors[self.specs[0]].device
        wearers = people.wearers(worn.values())
        images = wearers.images(self.split.unseen_backgrounds, settings, device)
        patterns = dict(worn) | controls(PEOPLE_CONTROLS, OwnClothing(clothes_cover(logo)), settings.seed)
        return self.measure_once(images, patterns, detectors, settings, "people", ())


def _short(specs: Sequence[str]) -> str:
    return ", ".join(map(short_name, specs))
