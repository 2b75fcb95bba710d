"""Assess one detector: measure it clean, attack it, and fill its card."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from cloak_core import __version__
from cloak_core.core.evaluation.results import Results
from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.logo import Cover, area_share, load_logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.source import NOBODY, Cast
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.files.errors import InputError, one_line
from cloak_core.files.identity import sha256_record
from cloak_core.files.writing import remove_all_leftovers, write_json
from cloak_core.patterns.controls import OwnClothing, controls
from cloak_core.patterns.faces import FacePattern
from cloak_core.studies.card.figures import attack_record, card_of, detector_facts, expected_card, fixed
from cloak_core.studies.card.page import keep_pictures
from cloak_core.studies.card.protocol import (
    AGAINST,
    BESIDE,
    CIRCLE,
    FRONT,
    GREY_HEAD,
    HEAD_CLOTH,
    HEADS,
    ROWS,
    Part,
    Size,
    keep_rows,
    nested_areas,
    part_of_area,
    parts_of,
)
from cloak_core.studies.card.words import others_strongest
from cloak_core.studies.opening import CLOTHES, clothes_cover, open_pattern, run_pattern
from cloak_core.studies.pace import TRAINED, DetectorPace, OnWork, Work, measured_pace
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
    size: Size
    folder: Path
    """Takes card.json, the rows behind it and what is shown beside it."""
    zoo: Sequence[str] | None = None
    """Entries whose cloaks it is shown; None: all there are."""
    on_work: OnWork | None = None
    people: Cast = NOBODY
    """People in photographs: the first ones are dressed in the largest cloak, another detector's, and the patterns."""
    patterns: Sequence[str] = ()
    """Pictures to be worn, as `open_pattern` takes them: FILE.png@tile=METRES, FILE.png@patch=METRES."""
    logo: str | None = None
    """What patterns cover, but for those on the chest: regions; None: shirt and trousers."""

    def __post_init__(self) -> None:
        (self.spec,) = self.store.specs
        self.split = self.store.split
        self.detector = self.split.detectors[self.spec]
        self.areas = nested_areas(self.split.bodies, self.size.areas)
        self.entries = self._entries()
        self.people = self.people.first(self.size.people)
        cover, over = clothes_cover(self.logo), f" on {self.logo}" if self.logo else ""
        opened = [(name + over, pattern.on(cover)) for pattern, _, name in map(open_pattern, self.patterns)]
        names = [name for name, _ in opened]
        if len(set(names)) < len(names):
            raise InputError(f"--patterns: {max(names, key=names.count)} is given twice")
        self.opened = dict(opened[: self.size.patterns])
        self.left_patterns = names[self.size.patterns :]

    def _entries(self) -> dict[str, tuple[Path, dict]]:
        """Find the zoo's cloaks that this scene can wear: run folder, and what the card says of each, by name.

        One that was trained against this very detector does not count.
        """
        entries, unseen = {}, self.split.unseen
        for name in shelved() if self.zoo is None else self.zoo:
            path = run_path(name if name.startswith(MARK) else MARK + name)
            config = read_run(path)
            if config.get("topology") == self.split.bodies.topology:
                said = {
                    "name": name.removeprefix(MARK),
                    "trained_against_it": trained_against(config, self.split.detectors)[self.spec],
                    "unseen": seen_in_training(config, unseen, self.split.unseen_backgrounds)[0],
                    "area": round(area_share(unseen, load_logo(unseen, path / "logo.npy").face_ids), 4),
                }
                entries[said["name"]] = path, said
            elif self.zoo is not None:
                raise InputError(f"{name}: made for another topology than scene '{self.split.bodies.name}'")
        return entries

    @cached_property
    def card_facts(self) -> dict:
        """What the card says itself (`entry.CARD`), but for who is left out of people, and the seconds."""
        options, facts = self.store.options, detector_facts(self.detector)
        areas = [(round(area_share(self.split.bodies, faces), 4), len(faces)) for faces in self.areas]
        made = {"cloak": __version__, "command": one_line(options.command), "seed": options.seed}
        return {
            "spec": self.spec,
            "size": self.size.name,
            **facts,
            "cover": self.logo or CLOTHES,
            "made": made | environment(),
            "materials": self.split.record() | self.people.summary("shown_people"),
            "left_patterns": self.left_patterns,
            "white_box": [{"area": area, "faces": n} for area, n in areas if facts["differentiable"]],
            "black_box": {"zoo": [said for _, said in self.entries.values()]},
            # A patch is worn in photographs alone.
            "patterns": [{"name": name} for name, pattern in self.opened.items() if pattern.period],
            "photographs": {"left_out": {}} if self.people else None,
            "seconds": 0.0,
        }

    @cached_property
    def parts(self) -> list[Part]:
        """What there is to measure, in order."""
        return parts_of(self.card_facts, self.size)

    # --- how long it takes

    def costs(self, worn: float = 1.0) -> dict[str, tuple[float, float]]:
        """By part, images to train on and to look at; worn: what a picture of somebody dressed counts."""
        batch, costs = self.store.train_settings().run.batch, {}
        for part in self.parts:
            views = self.split.unseen.pose_count * len(part.angles) * self.size.images_per_view * part.repetitions
            trained, looked = float(TRAINED * batch * part.steps * part.repetitions), float(views * (len(BESIDE) + 1))
            if part.name == "clean":
                looked = 6.0 * self.size.clean_images + self.size.bare
            elif part.name == "people":
                looked = worn * len(self.people) * (len(PEOPLE_CONTROLS) + 2 + len(HEADS) + 1 + len(self.opened))
            elif part.name == "circle":
                looked += trained / TRAINED  # all around, an image that is trained on is a new view, too
            costs[part.name] = trained, looked
        return costs

    def work(self, worn: float = 1.0) -> Work:
        """Count what is done; what an earlier call for the same has done counts, too."""
        asked = {key: value for key, value in self.card_facts.items() if key != "made"}
        patterns = list(self.patterns[: self.size.patterns])
        key = sha256_record([fixed(self.size), self.store.options.seed, patterns, asked])
        return Work(self.costs(worn), self.folder / "spent.json", key, self.on_work, self.size.seeds)

    def seconds_left(self, pace: DetectorPace | None = None) -> tuple[float, DetectorPace]:
        """Estimate the time of what is not done yet, and the detector's pace. pace: where it is known."""
        # Cards train on one thread.
        pace = pace or measured_pace(self.detector, self.store.options.size, gradient_threads=1)
        return self.work(self._dressing(pace) if self.people else 1.0).seconds_left(pace), pace

    def _dressing(self, pace: DetectorPace) -> float:
        """Clock two people in photographs, fitted and dressed: a picture's cost, in images that are looked at."""
        few = self.people.first(CLOCKED_PEOPLE)
        started = time.monotonic()
        images = few.images(self.split.unseen_backgrounds, WearSettings())
        worn = controls(PEOPLE_CONTROLS, OwnClothing(clothes_cover()))
        for _ in images.compose(range(len(images.trials)), list(worn.values())):
            pass
        return 1 + (time.monotonic() - started) / (max(1, len(few) * len(worn)) * max(pace.forward, 1e-6))

    # --- the card

    def expected(self) -> dict:
        """Make up the card of this call before anything is measured: see `expected_card`."""
        return expected_card(self.card_facts, self.size, list(self.opened))

    def run(self) -> dict:
        """Make the card. `Stopped` where a training was stopped in order: the same call goes on from there."""
        self.folder.mkdir(parents=True, exist_ok=True)
        work, figures = self.work(), dict(self.card_facts)
        self.store.on_event, self.store.on_images = work.on_event, work.on_images
        rows: dict[str, list[Results]] = {}
        trained: dict[str, Trained] = {}
        for part in self.parts:
            with work.part(part.name):
                if part.name == "people":
                    cloak = trained.get(part_of_area(self.size.areas[-1]))
                    worn = self._worn_by_people(cloak, rows)
                    rows["people"] = [self.store.measure_people(worn, self.people, WearSettings(bare=0), self.logo)]
                    figures["photographs"] = {"left_out": self.people.wearers(worn.values()).people.left_out}
                else:
                    repetitions = self._train(part) if part.steps else [self._untrained(part)]
                    trained[part.name] = repetitions[0]
                    rows[part.name] = [
                        self.store.measure_repetitions([one], part.angles, **part.settings) for one in repetitions
                    ]
                keep_rows(self.folder, part, rows[part.name])
        figures["seconds"] = work.seconds
        # Rows of an earlier card of another size, or with people.
        kept = {name for part in self.parts for name in part.files}
        for path in (self.folder / ROWS).glob("*.npz"):
            if path.name not in kept:
                path.unlink()
        card = card_of(figures, self.size, rows)
        seen = [(part, trained[part.name].pattern, rows[part.name][0]) for part in self.parts if part.name in trained]
        pictures = keep_pictures(self.folder / "pictures", self.store, seen, card)
        remove_all_leftovers(self.folder)
        write_json(self.folder / "pictures.json", pictures)
        write_json(self.folder / "card.json", card)
        return card

    def _train(self, part: Part) -> list[Trained]:
        """Train a part's cloak on one thread, once for each seed.

        Another number of threads sums in another order, and hundreds of updates make that a figure.
        """
        faces = self.areas[-1] if part.area is None else self.areas[self.size.areas.index(part.area)]
        angles = FRONT if part.area is not None else CIRCLE
        with torch_threads(1):
            return self.store.train_repetitions(faces, [self.spec], angles=angles, steps=part.steps)

    def _untrained(self, part: Part) -> Trained:
        """Take what a part shows that nobody trains here: noise, a cloak of the zoo, or a published pattern."""
        kind, _, name = part.name.partition(" ")
        bodies = self.split.unseen
        largest = Cover(self.areas[-1], bodies.topology)
        if kind == "zoo":
            path, _ = self.entries[name]
            return self.store.untrained(run_pattern(path, load_logo(bodies, path / "logo.npy"), bodies), path)
        if kind == "pattern":
            cover = load_logo(bodies, self.logo) if self.logo else largest
            return self.store.untrained(replace(self.opened[name], cover=cover, bodies=bodies), Path(name))
        noise = np.random.default_rng([self.store.options.seed, 0xB1]).integers(0, 2, (len(largest), 1))
        return self.store.untrained(FacePattern(largest, colors=np.repeat(noise, 3, 1).astype(np.float32)))

    def _worn_by_people(self, largest: Trained | None, rows: dict[str, list[Results]]) -> dict[str, Pattern]:
        """List what people wear: the largest cloak, made on renders, the zoo's strongest, patterns, and heads."""
        worn = {} if largest is None else {AGAINST: largest.pattern}
        zoo = self.card_facts["black_box"]["zoo"]
        strange = others_strongest([row | attack_record(rows[f"zoo {row['name']}"][0], self.spec) for row in zoo])
        if strange:
            worn[MARK + strange["name"]] = open_pattern(MARK + strange["name"])[0]
        cloth, _, _ = open_pattern(HEAD_CLOTH)
        heads = {name: cloth.on(clothes_cover(regions)) for name, regions in HEADS.items()}
        grey = controls(("grey",), OwnClothing(clothes_cover("head")))
        return worn | self.opened | heads | {GREY_HEAD: grey["grey"]}
