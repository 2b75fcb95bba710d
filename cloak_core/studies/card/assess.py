"""Assess one detector: measure it clean, attack it, and fill its card."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int64

from cloak_core import __version__
from cloak_core.core.evaluation.controls import CLOTHING, NATURAL
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.logo import area_share, load_logo
from cloak_core.core.run_config import environment
from cloak_core.exchange.colors import read_colors
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.files.writing import write_json
from cloak_core.sources.photographs.people import People
from cloak_core.sources.photographs.views import logo_positions
from cloak_core.studies import statistics_card
from cloak_core.studies.card import protocol
from cloak_core.studies.card.page import keep_pictures
from cloak_core.studies.card.words import untested_here
from cloak_core.studies.card.work import TRAINED, OnWork, Work
from cloak_core.studies.cloaked import cloth_colors
from cloak_core.studies.store import MEASUREMENT_VERSION, TRAINING_VERSION, RunStore, Trained
from cloak_core.studies.trained_run import read_run, seen_in_training, trained_against
from cloak_core.studies.wearing.clothes import CONTROLS, Clothes, LogoClothes, read_clothes
from cloak_core.studies.wearing.wearing import wear_and_judge
from cloak_core.zoo.entry import MARK, run_path, shelved

FORMAT = "cloak card 1"
BESIDE = (CLOTHING, "random")
"""Controls beside every cloak."""
BARE = 256
"""Scenes without anybody, for false alarms; they are looked at once, and not again with every cloak."""
LEAST_COUNT = 12
"""Steps and images that are never fewer, however short the time."""


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
    people: People | None = None
    """People in photographs, to be dressed in the largest cloak and in the patterns."""
    patterns: Sequence[str] = ()
    """Pictures to be worn as cloth that repeats: FILE.png@tile=METRES."""
    began: float = field(default_factory=time.monotonic)
    """`time.monotonic()` before materials and detector were loaded; that counts towards the budget's minutes."""
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
        """Make the card. `Stopped` where a training was stopped in order: the same call goes on from there."""
        budget = self.budget
        rate = self._seconds_per_image() if budget.minutes else 0.0
        worn = self._worn_image(rate) if rate and self.people is not None and len(self.people) else 1.0
        smaller = [_name(area) for area in budget.areas[:-1]] + ["circle"] if self.white_box else []
        told = self._asked(), self.on_work, budget.seeds, budget.minutes, rate, smaller
        work = Work(self._costs(worn), self.folder / "spent.json", *told, prepared=time.monotonic() - self.began)
        self.store.on_event, self.store.on_images = work.on_event, work.on_images
        card = self._head()
        with work.part("clean") as share:
            card |= self._clean(share)
        card |= {"white_box": [], "circle": None}
        for area, faces in zip(budget.areas, self._areas, strict=True) if self.white_box else ():
            with work.part(_name(area)) as share:
                card["white_box"] += [self._area(area, faces, share)] if share else []
        if self.white_box:
            with work.part("circle") as share:
                card |= self._circle(share) if share else {}
        if self.people is not None:
            with work.part("people") as share:
                card["photographs"] = self._photographs(share)
        if self.patterns:
            with work.part("patterns") as share:
                card["patterns"] = [self._pattern(spec, share) for spec in self.patterns]
        with work.part("zoo") as share:
            card["black_box"] = self._black_box(share)
        card["not_tested"] = untested_here(card)
        pictures = keep_pictures(self.folder / "pictures", self.store, self.shown, card)
        write_json(self.folder / "pictures.json", pictures)
        card["shares"], card["seconds"] = work.shares, work.seconds
        write_json(self.folder / "card.json", card)
        return card

    @torch.no_grad()
    def _seconds_per_image(self) -> float:
        """Clock the detector on a few grey images, the second time."""
        images = torch.full((4, 3, self.store.options.size, self.store.options.size), 0.5, device=self.detector.device)
        self.detector(images)
        started = time.monotonic()
        self.detector(images).scores.cpu()
        return (time.monotonic() - started) / len(images)

    def _worn_image(self, rate: float) -> float:
        """Clock two people in photographs, dressed and judged, the second time: the cost of a picture, in images that
        take `rate` seconds. To dress somebody may take longer than to look at the picture."""
        people = replace(self.people, people=self.people.people[:2])
        self._wear([], people)
        started = time.monotonic()
        self._wear([], people)
        return max(1.0, (time.monotonic() - started) / (len(people) * (1 + len(CONTROLS)) * rate))

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

    def _costs(self, worn: float) -> dict[str, tuple[float, float]]:
        """By part, images to train on and to look at; worn: what a picture of somebody dressed counts."""
        budget, poses = self.budget, self.split.unseen.pose_count
        batch, places = self.store.train_settings().run.batch, poses * budget.images_per_view * budget.seeds
        looks = (len(BESIDE) + 1) * places
        steps = TRAINED * batch * budget.steps * budget.seeds
        costs = {"clean": (0.0, 6.0 * budget.clean_images + BARE)}
        if self.white_box:
            costs |= {_name(area): (steps, looks * len(budget.front_angles)) for area in budget.areas}
            # All around, an image that is trained on is a new view, as one that is looked at.
            costs["circle"] = 2 * steps, looks * len(budget.circle_angles) + 2 * steps / TRAINED
        front = looks / budget.seeds * len(budget.front_angles)
        if self.people is not None:
            costs["people"] = 0.0, worn * len(self.people) * (len(CONTROLS) + 2 + len(self.patterns))
        if self.patterns:
            costs["patterns"] = 0.0, front * len(self.patterns)
        return costs | {"zoo": (0.0, front * len(self.entries))}

    def _asked(self) -> str:
        asked = {"budget": asdict(self.budget), "seed": self.store.options.seed, "protocol": protocol.VERSION}
        asked |= {"people": self.people and len(self.people), "patterns": list(self.patterns)}
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

    def _clean(self, part: float) -> dict:
        """Measure own clothing and untrained patterns from everywhere, and bare scenes."""
        faces = self._areas[-1]
        noise = np.random.default_rng([self.store.options.seed, 0xB1]).integers(0, 2, (len(faces), 1))
        worn = self.store.untrained(np.repeat(noise, 3, 1).astype(np.float32), faces, Path("black and white"))
        angles, elevations, distances = protocol.CLEAN_ANGLES, protocol.CLEAN_ELEVATIONS, protocol.CLEAN_DISTANCES
        views = len(angles) * len(elevations) * len(distances) * self.split.unseen.pose_count
        settings = {
            "elevations": elevations,
            "distances": distances,
            "images_per_view": math.ceil(self.budget.clean_images / views),
            "most_images": _fewer(self.budget.clean_images, part),
            "bare": _fewer(BARE, part),
            "controls": (CLOTHING, "grey", "random", *NATURAL),
        }
        results = self._evaluated("clean", [worn], angles, settings)
        return {
            "clean": statistics_card.clean_record(results, self.spec),
            "recall_by": statistics_card.recall_by(results, self.spec),
            "controls": statistics_card.control_records(results, self.spec, logo="noise"),
        }

    def _area(self, area: float, faces: Int64[np.ndarray, " L"], part: float) -> dict:
        """Train a cloak of this area against the detector and judge it from the front."""
        steps = _fewer(self.budget.steps, part)
        results = self._attacked(_name(area), faces, protocol.FRONT, steps, self.budget.front_angles, part)
        share = round(area_share(self.split.bodies, faces), 4)
        label = {"asked": area, "area": share, "faces": len(faces), "steps": steps}
        return label | statistics_card.attack_record(results, self.spec)

    def _circle(self, part: float) -> dict:
        """Train the largest cloak all around and judge it so."""
        steps, angles = _fewer(2 * self.budget.steps, part), self.budget.circle_angles
        results = self._attacked("circle", self._areas[-1], protocol.CIRCLE, steps, angles, part)
        row = statistics_card.attack_record(results, self.spec)
        row |= {"by_angle": statistics_card.by_angle_record(results, self.spec), "steps": steps}
        return {"circle": row["success"], "around": row}

    def _photographs(self, part: float) -> dict:
        """Dress people in photographs in the largest cloak, made on renders, and in the patterns."""
        people = replace(self.people, people=self.people.people[: _fewer(len(self.people), part)])
        clothes = [read_clothes(spec) for spec in self.patterns]
        if self.white_box:
            worn, _, _ = self.shown[_name(self.budget.areas[-1])]
            position = logo_positions(self.split.bodies.topology, worn.logo.face_ids)
            clothes.insert(0, LogoClothes(protocol.AGAINST, position, worn.colors))
        told = self._wear(clothes, people)
        return {"people": told["people"], "left_out": told["left_out"], "rows": told["detectors"][self.spec]}

    def _wear(self, clothes: Sequence[Clothes], people: People) -> dict:
        judges = {self.spec: self.detector}
        return wear_and_judge(clothes, people, judges, self.split.unseen_backgrounds, settings=WearSettings(bare=0))

    def _pattern(self, spec: str, part: float) -> dict:
        """Show it a published pattern as cloth for shirt and trousers, from the front."""
        cloth = read_clothes(spec)
        colors = cloth_colors(cloth.picture, cloth.metres, self.split.unseen, self._areas[-1])
        worn = self.store.untrained(colors, self._areas[-1], Path(cloth.name))
        results = self._evaluated(f"pattern {cloth.name}", [worn], self.budget.front_angles, self._front(part))
        return {"name": cloth.name} | statistics_card.attack_record(results, self.spec)

    def _black_box(self, part: float) -> dict:
        """Show it the zoo's cloaks; those trained against this very detector say so, and do not count."""
        split, found = self.split, []
        for entry in self.entries:
            ids = load_logo(split.unseen, entry["path"] / "logo.npy").face_ids
            worn = self.store.untrained(read_colors(entry["path"] / "colors.npy", len(ids)), ids, entry["path"])
            results = self._evaluated(f"zoo {entry['name']}", [worn], self.budget.front_angles, self._front(part))
            unseen, _ = seen_in_training(entry["config"], split.unseen, split.unseen_backgrounds)
            white = trained_against(entry["config"], split.detectors)[self.spec]
            label = {"name": entry["name"], "trained_against_it": white, "unseen": unseen}
            label["area"] = round(area_share(split.unseen, ids), 4)
            found.append(label | statistics_card.attack_record(results, self.spec))
        counted = [row for row in found if not row["trained_against_it"]]
        worst = max(counted, key=lambda row: (row["success_own"], row["success"]), default=None)
        most = {key: max((row[key] for row in counted), default=None) for key in ("success", "success_own")}
        return {"zoo": found, "counted": len(counted), "worst": worst and worst["name"]} | most

    def _front(self, part: float) -> dict:
        settings = {"images_per_view": self.budget.images_per_view, "controls": BESIDE, "bare": 1}
        full = self.split.unseen.pose_count * len(self.budget.front_angles) * self.budget.images_per_view
        return settings | ({"most_images": _fewer(full, part)} if part < 1 else {})

    def _attacked(
        self,
        part: str,
        faces: Int64[np.ndarray, " L"],
        trained_angles: str,
        steps: int,
        angles: tuple[float, ...],
        share: float,
    ) -> Results:
        changes = {"angles": trained_angles, "steps": steps}
        trained = self.store.train_repetitions(faces, [self.spec], **changes)
        return self._evaluated(part, trained, angles, self._front(share))

    def _evaluated(self, part: str, trained: Sequence[Trained], angles: tuple[float, ...], settings: dict) -> Results:
        self.shown[part] = (trained[0], angles, settings)
        return self.store.evaluate(trained, angles, **settings)


def _fewer(count: int, share: float) -> int:
    """The share of a count, at least `LEAST_COUNT` of it."""
    return max(min(count, LEAST_COUNT), round(count * share))


def _name(area: float) -> str:
    return f"area {area:.0%}"
