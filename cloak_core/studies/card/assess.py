"""Assess one detector: measure it clean, attack it, and fill its card."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from cloak_core import __version__
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.logo import Cover, area_share, load_logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.files.errors import InputError, one_line
from cloak_core.files.identity import sha256_record
from cloak_core.files.writing import remove_all_leftovers, write_json
from cloak_core.patterns.controls import OwnClothing, controls
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.photographs.fits import fit_people
from cloak_core.sources.photographs.people import People
from cloak_core.sources.photographs.source import fit_wearers
from cloak_core.studies.card import protocol
from cloak_core.studies.card.expected import expected_card
from cloak_core.studies.card.figures import VERSIONS, card_of, detector_facts, others_strongest
from cloak_core.studies.card.page import keep_pictures
from cloak_core.studies.card.parts import (
    BESIDE,
    Part,
    drop_other_rows,
    keep_rows,
    make_part,
    part_of_area,
    parts_of,
)
from cloak_core.studies.card.work import TRAINED, OnWork, Work
from cloak_core.studies.data_split import people_record
from cloak_core.studies.imagery import people_images
from cloak_core.studies.opening import CLOTHES, clothes_cover, open_pattern, run_pattern
from cloak_core.studies.pace import Pace, measured_pace
from cloak_core.studies.statistics_card import attack_record
from cloak_core.studies.store import PEOPLE_CONTROLS, RunStore
from cloak_core.studies.trained_run import read_run, seen_in_training, trained_against
from cloak_core.studies.training_store import Trained
from cloak_core.studies.trainings.run_record import environment
from cloak_core.zoo.entry import MARK, run_path, shelved

CLOCKED_PEOPLE = 2
"""People in photographs whose dressing is clocked."""


@dataclass(eq=False)
class Assessment:
    """One detector (the store's only one) under the protocol, into OUT/NAME; the store's folder is shared."""

    store: RunStore
    size: protocol.Size
    folder: Path
    """Takes card.json, the rows behind it and what is shown beside it."""
    zoo: Sequence[str] | None = None
    """Entries whose cloaks it is shown; None: all there are."""
    on_work: OnWork | None = None
    people: People | None = None
    """People in photographs: the first ones are dressed in the largest cloak, another detector's, and the patterns."""
    patterns: Sequence[str] = ()
    """Pictures to be worn, as `open_pattern` takes them: FILE.png@tile=METRES, FILE.png@patch=METRES."""
    logo: str | None = None
    """What patterns cover, but for those on the chest: regions; None: shirt and trousers."""
    shown: dict[str, tuple[Trained, tuple[float, ...], dict]] = field(default_factory=dict, init=False)
    """What pictures may be taken of, by part: a cloak, its test azimuths and evaluation settings."""
    rows: dict[str, list[Results]] = field(default_factory=dict, init=False)
    """By part, a table for each repetition."""

    def __post_init__(self) -> None:
        (self.spec,) = self.store.specs
        self.split = self.store.split
        self.detector = self.split.detectors[self.spec]
        self.white_box = self.detector.differentiable
        self.folder.mkdir(parents=True, exist_ok=True)
        self.entries = self._entries()
        if self.people is not None:
            self.people = replace(self.people, people=self.people.people[: self.size.people])
        cover, over = clothes_cover(self.logo), f" on {self.logo}" if self.logo else ""
        self.opened = [(name + over, pattern.on(cover)) for pattern, _, name in map(open_pattern, self.patterns)]
        names = [name for name, _ in self.opened]
        if len(set(names)) < len(names):
            raise InputError(f"--patterns: {max(names, key=names.count)} is given twice")
        self.patterns = self.patterns[: self.size.patterns]
        self.opened, self.left = self.opened[: self.size.patterns], names[self.size.patterns :]

    def run(self) -> dict:
        """Make the card. `Stopped` where a training was stopped in order: the same call goes on from there."""
        work = Work(self.costs(), self._spent, self._asked(), self.on_work, self.size.seeds)
        self.store.on_event, self.store.on_images = work.on_event, work.on_images
        told = self._head() | {"white_box": [], "black_box": {"zoo": []}, "patterns": [], "photographs": None}
        with work.part("clean"):
            self._clean()
        for area, faces in zip(self.size.areas, self._areas, strict=True) if self.white_box else ():
            with work.part(part_of_area(area)):
                told["white_box"].append(self._area(area, faces))
        if self.white_box and self.size.circle:
            with work.part("circle"):
                self._measure("circle", self._trained(self._areas[-1], protocol.CIRCLE, 2 * self.size.steps))
        with work.part("zoo"):
            told["black_box"]["zoo"] += map(self._entry, self.entries)
        if self.patterns:
            with work.part("patterns"):
                rows = (self._pattern(*one) for one in self.opened)
                told["patterns"] += [row for row in rows if row]
        if self.people is not None:
            with work.part("people"):
                told["photographs"] = self._photographs(told)
        told["seconds"] = work.seconds
        drop_other_rows(self.folder, parts_of(told, self.size))
        card = card_of(told, self.size, self.rows)
        pictures = keep_pictures(self.folder / "pictures", self.store, self.shown, card)
        remove_all_leftovers(self.folder)
        write_json(self.folder / "pictures.json", pictures)
        write_json(self.folder / "card.json", card)
        return card

    def expected(self) -> dict:
        """Make up the card of this call: see `expected_card`."""
        unseen = {"bodies": None, "backgrounds": None}
        zoo = [
            {"name": entry["name"], "trained_against_it": False, "unseen": unseen, "area": 0} for entry in self.entries
        ]
        told = {
            **self._head(),
            "white_box": [{"area": area, "faces": 0} for area in self.size.areas] if self.white_box else [],
            "black_box": {"zoo": zoo},
            "patterns": [{"name": name} for name, pattern in self.opened if pattern.period],
            "photographs": None if self.people is None else {"left_out": {}},
            "seconds": 0.0,
        }
        return expected_card(told, self.size, [name for name, _ in self.opened])

    def seconds_left(self, pace: Pace | None = None) -> tuple[float, Pace]:
        """Estimate the time of what is not done yet, and the detector's pace. pace: where it is known."""
        # Cards train on one thread.
        pace = pace or measured_pace(self.detector, self.store.options.size, gradient_threads=1)
        costs = self.costs(self._dressing(pace) if self.people is not None else 1.0)
        return Work(costs, self._spent, self._asked()).seconds_left(pace), pace

    @property
    def _spent(self) -> Path:
        return self.folder / "spent.json"

    def _dressing(self, pace: Pace) -> float:
        """Clock two people in photographs, fitted and dressed: a picture's cost, in images that are looked at."""
        few = replace(self.people, people=self.people.people[:CLOCKED_PEOPLE])
        started = time.monotonic()
        images = people_images(fit_people(few), self.split.unseen_backgrounds, WearSettings())
        every, worn = range(len(images.trials)), controls(PEOPLE_CONTROLS, OwnClothing(clothes_cover()))
        for _ in images.compose(every, list(worn.values())):
            pass
        return 1 + (time.monotonic() - started) / (max(1, len(few) * len(worn)) * max(pace.forward, 1e-6))

    # --- what there is to do

    @cached_property
    def _areas(self) -> list[Int64[np.ndarray, " L"]]:
        return protocol.nested_areas(self.split.bodies, self.size.areas)

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

    def costs(self, worn: float = 1.0) -> dict[str, tuple[float, float]]:
        """By part, images to train on and to look at; worn: what a picture of somebody dressed counts."""
        size, poses = self.size, self.split.unseen.pose_count
        batch, places = self.store.train_settings().run.batch, poses * size.images_per_view * size.seeds
        looks = (len(BESIDE) + 1) * places
        steps = TRAINED * batch * size.steps * size.seeds
        costs = {"clean": (0.0, 6.0 * size.clean_images + size.bare)}
        if self.white_box:
            costs |= {part_of_area(area): (steps, looks * len(size.front_angles)) for area in size.areas}
        if self.white_box and size.circle:
            # All around, an image that is trained on is a new view, as one that is looked at.
            costs["circle"] = 2 * steps, looks * len(size.circle_angles) + 2 * steps / TRAINED
        front = looks / size.seeds * len(size.front_angles)
        costs["zoo"] = 0.0, front * len(self.entries)
        if self.patterns:
            costs["patterns"] = 0.0, front * len(self.patterns)
        if self.people is not None:
            costs["people"] = 0.0, worn * len(self.people) * (len(PEOPLE_CONTROLS) + 2 + len(self.patterns))
        return costs

    def _asked(self) -> str:
        asked = {"size": asdict(self.size), "seed": self.store.options.seed, "protocol": protocol.VERSION}
        asked |= {"people": self.people and people_record(self.people), "patterns": list(self.patterns)}
        asked |= {"cover": self.logo} if self.logo else {}
        return sha256_record(asked | VERSIONS | {"split": self.split.record()})

    def _head(self) -> dict:
        options = self.store.options
        made = {"cloak": __version__, "command": one_line(options.command), "seed": options.seed}
        materials = self.split.record() | ({"shown_people": people_record(self.people)} if self.people else {})
        return {
            "size": self.size.name,
            "spec": self.spec,
            **detector_facts(self.detector),
            "cover": self.logo or CLOTHES,
            "made": made | environment(),
            "materials": materials,
            "left_patterns": self.left,
        }

    # --- the parts

    def _clean(self) -> None:
        """Measure own clothing and untrained patterns from everywhere, and bare scenes."""
        faces = self._areas[-1]
        noise = np.random.default_rng([self.store.options.seed, 0xB1]).integers(0, 2, (len(faces), 1))
        colors = np.repeat(noise, 3, 1).astype(np.float32)
        self._measure("clean", [self.store.untrained(FacePattern(self._cover(faces), colors=colors))])

    def _area(self, area: float, faces: Int64[np.ndarray, " L"]) -> dict:
        """Train a cloak of this area against the detector and judge it from the front."""
        self._measure(part_of_area(area), self._trained(faces, protocol.FRONT, self.size.steps))
        return {"area": round(area_share(self.split.bodies, faces), 4), "faces": len(faces)}

    def _photographs(self, told: dict) -> dict:
        """Dress people in photographs in the largest cloak, made on renders, the zoo's strongest, and the patterns."""
        worn = {}
        if self.white_box:
            worn[protocol.AGAINST] = self.shown[part_of_area(self.size.areas[-1])][0].pattern
        zoo = told["black_box"]["zoo"]
        zoo = [row | attack_record(self.rows[f"zoo {row['name']}"][0], self.spec) for row in zoo]
        if strange := others_strongest(zoo):
            worn[MARK + strange["name"]] = open_pattern(MARK + strange["name"])[0]
        worn |= dict(self.opened)
        self._keep(Part("people"), [self.store.measure_people(worn, self.people, WearSettings(bare=0), self.logo)])
        return {"left_out": fit_wearers(self.people, worn.values())[0].left_out}

    def _pattern(self, name: str, pattern: Pattern) -> dict | None:
        """Show it a published pattern as cloth for shirt and trousers, or `logo`, from the front; None of a patch."""
        if not pattern.period:
            return None
        bodies = self.split.unseen
        cover = load_logo(bodies, self.logo) if self.logo else self._cover(self._areas[-1])
        worn = replace(pattern, cover=cover, bodies=bodies)
        self._measure(f"pattern {name}", [self.store.untrained(worn, Path(name))])
        return {"name": name}

    def _cover(self, faces: Int64[np.ndarray, " L"]) -> Cover:
        return Cover(faces, self.split.unseen.topology)

    def _entry(self, entry: dict) -> dict:
        """Show it a cloak of the zoo; one trained against this very detector says so, and does not count."""
        split = self.split
        logo = load_logo(split.unseen, entry["path"] / "logo.npy")
        worn = self.store.untrained(run_pattern(entry["path"], logo, split.unseen), entry["path"])
        unseen, _ = seen_in_training(entry["config"], split.unseen, split.unseen_backgrounds)
        white = trained_against(entry["config"], split.detectors)[self.spec]
        self._measure(f"zoo {entry['name']}", [worn])
        label = {"name": entry["name"], "trained_against_it": white, "unseen": unseen}
        return label | {"area": round(area_share(split.unseen, logo.face_ids), 4)}

    def _trained(self, faces: Int64[np.ndarray, " L"], angles: str, steps: int) -> list[Trained]:
        """Train on one thread: another number sums in another order, and hundreds of updates make that a figure."""
        with torch_threads(1):
            return self.store.train_repetitions(faces, [self.spec], angles=angles, steps=steps)

    def _measure(self, name: str, trained: Sequence[Trained]) -> None:
        """Judge repetitions of a cloak for the part of this name."""
        part = make_part(name, self.size, self.store.options.seed, self.split.unseen.pose_count)
        self.shown[name] = (trained[0], part.angles, part.settings)
        self._keep(part, [self.store.measure_repetitions([one], part.angles, **part.settings) for one in trained])

    def _keep(self, part: Part, rows: list[Results]) -> None:
        """Keep a part's rows beside the card."""
        keep_rows(self.folder, part, rows)
        self.rows[part.name] = rows
