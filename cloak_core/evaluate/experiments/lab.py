"""Where experiments train and evaluate: each training and each evaluation is made once and found again by its content.

A run lives in OUT/runs/HASH, an evaluation in OUT/evaluations/HASH, the hash taken over everything that decides the
result. So experiments share them, and an interrupted set goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from cloak_core.attack.events import read_events
from cloak_core.attack.run_folder import FREE_SETTINGS
from cloak_core.attack.settings import TrainSettings, make_settings, settings_record
from cloak_core.attack.training import train
from cloak_core.detectors.protocol import Detector, state_hash
from cloak_core.errors import InputError
from cloak_core.evaluate.controls import NATURAL, STANDARD
from cloak_core.evaluate.experiments.materials import Materials, backgrounds_record, bodies_record
from cloak_core.evaluate.experiments.repeats import Repeats
from cloak_core.evaluate.measurement import Measurement, read_measurement
from cloak_core.evaluate.measuring import measure
from cloak_core.evaluate.settings import EvaluateSettings
from cloak_core.evaluate.success import make_stage
from cloak_core.scene.backgrounds import Backgrounds
from cloak_core.scene.exchange import Bodies, new_folder, read_colors, sha256_arrays, write_json
from cloak_core.scene.logo import Logo, make_logo

_log = logging.getLogger("cloak")
CONTROLS = (*STANDARD, *NATURAL)


class Interrupted(Exception):
    """A training was stopped in order; the same command goes on from there."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """How much an experiment does."""

    out: Path
    """Folder that takes results, runs and evaluations."""
    quick: bool = False
    """Fewer steps, angles, images and seeds: the whole set within 90 minutes on two cores."""
    preset: str = "best"
    """Training preset."""
    steps: int | None = None
    """Updates of every training; None: 300 when quick, else what the preset says."""
    batch: int | None = None
    """Images per update; None: what the preset says."""
    seeds: int | None = None
    """Repetitions of every training with another seed; None: 1 when quick, else 3."""
    images_per_view: int | None = None
    """Test images per body and angle; None: 2 when quick, else 8."""
    size: int = 416
    """Width and height of the images, pixels."""
    samples: int | None = None
    """Samples per pixel; None takes the renderer's default."""
    device: str = "cpu"
    """Torch device."""

    @property
    def seed_list(self) -> tuple[int, ...]:
        return tuple(range(self.seeds or (1 if self.quick else 3)))

    @property
    def test_images(self) -> int:
        return self.images_per_view or (2 if self.quick else 8)

    def counts(self) -> dict:
        """What "quick" and the options came to, for the record."""
        length = self.steps or (300 if self.quick else f"as in preset {self.preset}")
        return {"steps": length, "seeds": len(self.seed_list), "images_per_view": self.test_images, "quick": self.quick}


@dataclass(frozen=True, eq=False)
class Trained:
    """Colours of one training."""

    colors: np.ndarray
    logo: Logo
    folder: Path
    seconds: float
    settings: TrainSettings = field(repr=False)


class Lab:
    """Trains and evaluates on some materials, remembering both in files."""

    def __init__(
        self, materials: Materials, options: Options, on_progress: Callable[[str], None] | None = None
    ) -> None:
        self.materials, self.options = materials, options
        self._tell = on_progress or (lambda message: _log.info("%s", message))

    @property
    def specs(self) -> tuple[str, ...]:
        """Specs of the detectors, in order."""
        return tuple(self.materials.detectors)

    @cached_property
    def _detector_hashes(self) -> dict[str, str]:
        return {spec: state_hash(detector) for spec, detector in self.materials.detectors.items()}

    # --- training

    def train(
        self,
        faces: np.ndarray,
        specs: Sequence[str],
        *,
        bodies: Bodies | None = None,
        seed: int = 0,
        **changes: object,
    ) -> Trained:
        """Colours for these faces against these detectors; `changes` are training settings by name."""
        bodies = bodies or self.materials.bodies
        settings = self.train_settings(seed, **changes)
        logo = make_logo(bodies, faces)
        key = self._train_key(settings, bodies, logo, specs)
        folder = self.options.out / "runs" / key
        if not _is_done(folder):
            self._tell(f"training {key} ({', '.join(f'{k}={v}' for k, v in changes.items()) or 'default settings'})")
            detectors = [self.materials.detectors[spec] for spec in specs]
            result = train(settings, bodies, logo, detectors, self.materials.backgrounds, folder, resume=True)
            if result.stopped:
                raise Interrupted(f"{folder}: stopped at step {result.step}: {result.stopped}")
        colors = read_colors(folder / "colors.npy", len(logo))
        seconds = max((float(e.get("time", 0)) for e in read_events(folder / "events.jsonl")), default=math.nan)
        return Trained(colors, logo, folder, seconds, settings)

    def train_settings(self, seed: int = 0, **changes: object) -> TrainSettings:
        """The options' preset and counts, with changes by name."""
        options = self.options
        values: dict[str, object] = {"seed": seed, "size": options.size, "device": options.device}
        steps = options.steps or (300 if options.quick else None)
        if steps is not None:
            values["steps"] = steps
        if options.size < 416:
            values["translation"] = options.size // 8  # the presets' are meant for 416 pixels
        values |= {k: v for k, v in (("batch", options.batch), ("samples", options.samples)) if v is not None}
        return make_settings(**({"preset": options.preset} | values | changes))

    def _train_key(self, settings: TrainSettings, bodies: Bodies, logo: Logo, specs: Sequence[str]) -> str:
        record = {k: v for k, v in settings_record(settings).items() if k not in FREE_SETTINGS}
        return _key(
            {
                "settings": record,
                "bodies": bodies_record(bodies)["sha256"],
                "logo": sha256_arrays(logo.face_ids),
                "detectors": [[spec, self._detector_hashes[spec]] for spec in specs],
                "backgrounds": backgrounds_record(self.materials.backgrounds),
            }
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
        specs = tuple(specs or self.specs)
        settings = replace(
            EvaluateSettings(
                images_per_view=self.options.test_images,
                size=self.options.size,
                samples=self.options.samples,
                controls=CONTROLS,
                shift=min(50, self.options.size // 8),
            ),
            **changes,
        )
        return Repeats([self._measure(one, bodies, specs, tuple(map(float, angles)), settings) for one in trained])

    def _measure(
        self, trained: Trained, bodies: Bodies, specs: tuple[str, ...], angles: tuple, settings: EvaluateSettings
    ) -> Measurement:
        logo = make_logo(bodies, trained.logo.face_ids)
        backgrounds: Backgrounds = self.materials.unseen_backgrounds
        key = _key(
            {
                "settings": asdict(settings),
                "angles": angles,
                "bodies": bodies_record(bodies)["sha256"],
                "logo": sha256_arrays(logo.face_ids, trained.colors),
                "detectors": [[spec, self._detector_hashes[spec]] for spec in specs],
                "backgrounds": backgrounds_record(backgrounds),
            }
        )
        folder = self.options.out / "evaluations" / key
        if not (folder / "scores.npz").exists():
            self._tell(f"evaluating {trained.folder.name} as {key}")
            detectors: dict[str, Detector] = {spec: self.materials.detectors[spec] for spec in specs}
            stage = make_stage(trained.colors, logo, bodies, backgrounds, detectors, angles, settings)
            measurement = measure(stage, detectors, settings)
            with new_folder(folder) as temporary:
                record = {
                    "run": trained.folder.name,
                    "settings": asdict(settings),
                    "angles": angles,
                    "detectors": specs,
                }
                write_json(temporary / "config.json", record)
                measurement.save(temporary / "scores.npz")
        return read_measurement(folder / "scores.npz")


def _is_done(folder: Path) -> bool:
    """Whether a run ended by itself."""
    if not (folder / "colors.npy").exists():
        return False
    ends = [e for e in read_events(folder / "events.jsonl") if e.get("type") == "end"]
    return bool(ends) and ends[-1].get("outcome") == "done"


def _key(record: dict) -> str:
    """A short name for content: the first 16 digits of the SHA-256 of its canonical JSON."""
    try:
        text = json.dumps(record, sort_keys=True, allow_nan=False, separators=(",", ":"))
    except ValueError as error:
        raise InputError(f"settings: {error}") from None
    return hashlib.sha256(text.encode()).hexdigest()[:16]
