"""Assess one detector: measure it clean, attack it, and fill its card."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int64

from cloak_core import __version__
from cloak_core.attack.run_config import environment
from cloak_core.evaluation import statistics_card
from cloak_core.evaluation.card import protocol
from cloak_core.evaluation.card.pictures import keep_pictures
from cloak_core.evaluation.card.work import TRAINED, OnWork, Work
from cloak_core.evaluation.controls import CLOTHING, NATURAL
from cloak_core.evaluation.provenance import seen_in_training, trained_against
from cloak_core.evaluation.results import Results
from cloak_core.evaluation.store import MEASUREMENT_VERSION, TRAINING_VERSION, RunStore, Trained
from cloak_core.evaluation.trained_run import read_run
from cloak_core.exchange.colors import read_colors
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.files.writing import write_json
from cloak_core.scene.logos.logo import area_share, load_logo, make_logo
from cloak_core.zoo.shelf import MARK, run_path, shelved

FORMAT = "cloak card 1"
BESIDE = (CLOTHING, "random")
"""Controls beside every cloak."""


@dataclass(eq=False)
class Assessment:
    """One detector (the store's only one) under the protocol, into OUT/NAME; the store's folder is shared."""

    store: RunStore
    budget: protocol.Budget
    folder: Path
    """Takes card.json and what is shown beside it."""
    zoo: Sequence[str] | None = None
    """Entries whose cloaks it is shown; None: all there are."""
    on_work: OnWork | None = None
    shown: dict[str, tuple[Trained, tuple[float, ...], dict]] = field(default_factory=dict, init=False)
    """What pictures may be taken of, by part: a cloak, its test azimuths and evaluation settings."""

    def __post_init__(self) -> None:
        (self.spec,) = self.store.specs
        self.split = self.store.split
        self.detector = self.split.detectors[self.spec]
        self.white_box = self.detector.differentiable
        self.folder.mkdir(parents=True, exist_ok=True)
        self.entries = self._entries()

    def run(self) -> dict:
        """Make the card. `Interrupted` where a training was stopped in order: the same call goes on from there."""
        work = Work(self._costs(), self.folder / "spent.json", self._asked(), self.on_work, self.budget.seeds)
        self.store.on_event, self.store.on_images = work.on_event, work.on_images
        card = self._head()
        with work.part("clean"):
            card |= self._clean()
        card |= {"white_box": [], "circle": None}
        for area, faces in zip(self.budget.areas, self._areas, strict=True) if self.white_box else ():
            with work.part(_name(area)):
                card["white_box"].append(self._area(area, faces))
        if self.white_box:
            with work.part("circle"):
                card |= self._circle()
        with work.part("zoo"):
            card["black_box"] = self._black_box()
        card["not_tested"] = self._not_tested(card["black_box"]["counted"])
        pictures = keep_pictures(self.folder / "pictures", self.store, self.shown, card)
        write_json(self.folder / "pictures.json", pictures)
        card["seconds"] = work.seconds
        write_json(self.folder / "card.json", card)
        return card

    # --- what there is to do

    @cached_property
    def _areas(self) -> list[Int64[np.ndarray, " L"]]:
        return protocol.nested_areas(self.split.bodies, self.budget.areas)

    def _entries(self) -> list[dict]:
        """The zoo's cloaks that this scene can wear, by name, with their run folders and records."""
        found = []
        for name in shelved() if self.zoo is None else self.zoo:
            path = run_path(name if name.startswith(MARK) else MARK + name)
            config = read_run(path)
            if config.get("topology") == self.split.bodies.topology:
                found.append({"name": name.removeprefix(MARK), "path": path, "config": config})
            elif self.zoo is not None:
                raise InputError(f"{name}: made for another topology than scene '{self.split.bodies.name}'")
        return found

    def _costs(self) -> dict[str, tuple[float, float]]:
        budget, poses = self.budget, self.split.unseen.pose_count
        batch, places = self.store.train_settings().run.batch, poses * budget.images_per_view * budget.seeds
        looks = (len(BESIDE) + 1) * places
        steps = TRAINED * batch * budget.steps * budget.seeds
        costs = {"clean": (0.0, 6.0 * budget.clean_images)}
        if self.white_box:
            costs |= {_name(area): (steps, looks * len(budget.front_angles)) for area in budget.areas}
            costs["circle"] = 2 * steps, looks * len(budget.circle_angles)
        front = looks / budget.seeds * len(budget.front_angles)
        return costs | {"zoo": (0.0, front * len(self.entries))}

    def _asked(self) -> str:
        asked = {"budget": asdict(self.budget), "seed": self.store.options.seed, "protocol": protocol.VERSION}
        versions = {"training": TRAINING_VERSION, "measurement": MEASUREMENT_VERSION}
        return sha256_record(asked | versions | {"split": self.split.record()})

    def _head(self) -> dict:
        options, detector = self.store.options, self.detector
        made = {"cloak": __version__, "command": options.command, "seed": options.seed}
        return {
            "format": FORMAT,
            "protocol": protocol.VERSION,
            "budget": self.budget.name,
            "spec": self.spec,
            "operating_point": detector.operating_point,
            "operating_point_assumed": detector.operating_point_assumed,
            "differentiable": self.white_box,
            "partial_gradient": detector.partial_gradient,
            "made": made | environment(),
            "counts": asdict(self.budget) | {"size": options.size},
            "materials": self.split.record(),
        }

    # --- the parts

    def _clean(self) -> dict:
        """Measure own clothing and untrained patterns from everywhere, and bare scenes."""
        faces = self._areas[-1]
        noise = np.random.default_rng([self.store.options.seed, 0xB1]).integers(0, 2, (len(faces), 1))
        worn = self._worn(np.repeat(noise, 3, 1).astype(np.float32), faces, Path("black and white"))
        angles, elevations, distances = protocol.CLEAN_ANGLES, protocol.CLEAN_ELEVATIONS, protocol.CLEAN_DISTANCES
        views = len(angles) * len(elevations) * len(distances) * self.split.unseen.pose_count
        settings = {
            "elevations": elevations,
            "distances": distances,
            "images_per_view": math.ceil(self.budget.clean_images / views),
            "most_images": self.budget.clean_images,
            "controls": (CLOTHING, "grey", "random", *NATURAL),
        }
        results = self._evaluated("clean", [worn], angles, settings)
        return {
            "clean": statistics_card.clean_record(results, self.spec),
            "recall_by": statistics_card.recall_by(results, self.spec),
            "controls": statistics_card.control_records(results, self.spec, logo="noise"),
        }

    def _area(self, area: float, faces: Int64[np.ndarray, " L"]) -> dict:
        """Train a cloak of this area against the detector and judge it from the front."""
        results = self._attacked(_name(area), faces, protocol.FRONT, self.budget.steps, self.budget.front_angles)
        share = round(area_share(self.split.bodies, faces), 4)
        label = {"asked": area, "area": share, "faces": len(faces), "steps": self.budget.steps}
        return label | statistics_card.attack_record(results, self.spec)

    def _circle(self) -> dict:
        """Train the largest cloak all around and judge it so."""
        steps, angles = 2 * self.budget.steps, self.budget.circle_angles
        results = self._attacked("circle", self._areas[-1], protocol.CIRCLE, steps, angles)
        row = statistics_card.attack_record(results, self.spec)
        row |= {"by_angle": statistics_card.by_angle_record(results, self.spec), "steps": steps}
        return {"circle": row["success"], "around": row}

    def _black_box(self) -> dict:
        """Show it the zoo's cloaks; those trained against this very detector say so, and do not count."""
        split, found = self.split, []
        for entry in self.entries:
            ids = load_logo(split.unseen, entry["path"] / "logo.npy").face_ids
            worn = self._worn(read_colors(entry["path"] / "colors.npy", len(ids)), ids, entry["path"])
            results = self._evaluated(f"zoo {entry['name']}", [worn], self.budget.front_angles, self._front())
            unseen, _ = seen_in_training(entry["config"], split.unseen, split.unseen_backgrounds)
            white = trained_against(entry["config"], split.detectors)[self.spec]
            label = {"name": entry["name"], "trained_against_it": white, "unseen": unseen}
            label["area"] = round(area_share(split.unseen, ids), 4)
            found.append(label | statistics_card.attack_record(results, self.spec))
        counted = [row for row in found if not row["trained_against_it"]]
        worst = max(counted, key=lambda row: (row["success_own"], row["success"]), default=None)
        most = {key: max((row[key] for row in counted), default=None) for key in ("success", "success_own")}
        return {"zoo": found, "counted": len(counted), "worst": worst and worst["name"]} | most

    def _front(self) -> dict:
        return {"images_per_view": self.budget.images_per_view, "controls": BESIDE}

    def _attacked(
        self, part: str, faces: Int64[np.ndarray, " L"], trained_angles: str, steps: int, angles: tuple[float, ...]
    ) -> Results:
        changes = {"angles": trained_angles, "steps": steps}
        return self._evaluated(part, self.store.train_repetitions(faces, [self.spec], **changes), angles, self._front())

    def _worn(self, colors: Float32[np.ndarray, "L 3"], faces: Int64[np.ndarray, " L"], name: Path) -> Trained:
        """Colours that were not trained here."""
        logo = make_logo(self.split.unseen, faces)
        return Trained(colors, logo, name, math.nan, math.nan, self.store.train_settings())

    def _evaluated(self, part: str, trained: Sequence[Trained], angles: tuple[float, ...], settings: dict) -> Results:
        self.shown[part] = (trained[0], angles, settings)
        return self.store.evaluate(trained, angles, **settings)

    def _not_tested(self, counted: int) -> list[str]:
        """Say what this card cannot tell, for reasons of this detector or this call."""
        said = []
        if not self.white_box:
            said.append(
                "No white-box attack: the detector gives no gradients. An attacker who has its weights in another "
                "form may do far better than the cloaks shown here."
            )
        elif self.detector.partial_gradient:
            said.append(
                f"The gradient that the attack follows is not all of the answer's: {self.detector.partial_gradient}."
            )
        if not counted:
            why = (
                "those there are were made against it" if self.entries else "the zoo holds none for this scene's bodies"
            )
            said.append(f"No cloak made against other detectors: {why}.")
        return said


def _name(area: float) -> str:
    return f"area {area:.0%}"
