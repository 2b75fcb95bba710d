"""Assesses one detector: measures it clean, attacks it, and fills its card."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from cloak_core import __version__
from cloak_core.attack.run_config import environment
from cloak_core.evaluation.card import rows
from cloak_core.evaluation.card.areas import nested_areas
from cloak_core.evaluation.card.pictures import keep_pictures
from cloak_core.evaluation.card.protocol import (
    CIRCLE,
    CLEAN_ANGLES,
    CLEAN_DISTANCES,
    CLEAN_ELEVATIONS,
    FRONT,
    VERSION,
    Budget,
)
from cloak_core.evaluation.card.work import TRAINED, OnWork, Work
from cloak_core.evaluation.controls import CLOTHING, NATURAL
from cloak_core.evaluation.experiments.lab import MEASURING, Lab, Trained
from cloak_core.evaluation.experiments.repeats import Repeats
from cloak_core.evaluation.provenance import seen_in_training, trained_against
from cloak_core.evaluation.trained_run import read_run
from cloak_core.exchange.colors import read_colors
from cloak_core.files.errors import InputError
from cloak_core.files.identity import code_hash, sha256_record
from cloak_core.files.writing import write_json
from cloak_core.scene.logos.logo import area_share, load_logo, make_logo
from cloak_core.zoo.shelf import MARK, run_path, shelved

FORMAT = "cloak card 1"
BESIDE = (CLOTHING, "random")
"""Controls beside every cloak."""


@dataclass(eq=False)
class Assessment:
    """One detector (the lab's only one) under the protocol, into OUT/NAME; the lab's folder is shared with others."""

    lab: Lab
    budget: Budget
    folder: Path
    """Takes card.json and what is shown beside it."""
    zoo: Sequence[str] | None = None
    """Entries whose cloaks it is shown; None: all there are."""
    on_work: OnWork | None = None
    shown: dict[str, tuple[Trained, tuple[float, ...], dict]] = field(default_factory=dict, init=False)
    """What pictures may be taken of: a cloak, its test azimuths and settings, by part."""

    def __post_init__(self) -> None:
        (self.spec,) = self.lab.specs
        self.detector = self.lab.materials.detectors[self.spec]
        self.own = self.detector.operating_point
        self.white_box = self.detector.differentiable
        self.folder.mkdir(parents=True, exist_ok=True)
        self.entries = self._entries()

    def run(self) -> dict:
        """The card. `lab.Interrupted` where a training was stopped in order: the same call goes on from there."""
        work = Work(self._costs(), self.folder / "spent.json", self._asked(), self.on_work, self.budget.seeds)
        self.lab.on_event, self.lab.on_images = work.on_event, work.on_images
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
        card["not_tested"] = self._not_tested(card)
        pictures = keep_pictures(self.folder / "pictures", self.lab, self.shown, card)
        write_json(self.folder / "pictures.json", pictures)
        card["seconds"] = work.seconds
        write_json(self.folder / "card.json", card)
        return card

    # --- what there is to do

    @cached_property
    def _areas(self) -> list[np.ndarray]:
        return nested_areas(self.lab.materials.bodies, self.budget.areas)

    def _entries(self) -> list[dict]:
        """The zoo's cloaks that this scene can wear, by name, with their run folders and records."""
        found = []
        for name in shelved() if self.zoo is None else self.zoo:
            path = run_path(name if name.startswith(MARK) else MARK + name)
            config = read_run(path)
            if config.get("topology") == self.lab.materials.bodies.topology:
                found.append({"name": name.removeprefix(MARK), "path": path, "config": config})
            elif self.zoo is not None:
                raise InputError(f"{name}: made for another topology than scene '{self.lab.materials.bodies.name}'")
        return found

    def _costs(self) -> dict[str, tuple[float, float]]:
        budget, poses = self.budget, self.lab.materials.unseen.pose_count
        batch, places = self.lab.train_settings().run.batch, poses * budget.images_per_view * budget.seeds
        looks = (len(BESIDE) + 1) * places
        steps = TRAINED * batch * budget.steps * budget.seeds
        costs = {"clean": (0.0, 6.0 * budget.clean_images)}
        if self.white_box:
            costs |= {_name(area): (steps, looks * len(budget.front_angles)) for area in budget.areas}
            costs["circle"] = 2 * steps, looks * len(budget.circle_angles)
        front = looks / budget.seeds * len(budget.front_angles)
        return costs | {"zoo": (0.0, front * len(self.entries))}

    def _asked(self) -> str:
        asked = {"budget": asdict(self.budget), "seed": self.lab.options.seed, "code": code_hash(*MEASURING, "attack")}
        return sha256_record(asked | {"protocol": VERSION, "materials": self.lab.materials.record()})

    def _head(self) -> dict:
        head = {"format": FORMAT, "protocol": VERSION, "budget": self.budget.name, "spec": self.spec}
        head |= {"operating_point": self.own, "operating_point_assumed": self.detector.operating_point_assumed}
        head |= {"differentiable": self.white_box, "partial_gradient": self.detector.partial_gradient}
        made = {"cloak": __version__, "command": self.lab.options.command, "seed": self.lab.options.seed}
        counts = asdict(self.budget) | {"size": self.lab.options.size}
        return head | {"made": made | environment(), "counts": counts, "materials": self.lab.materials.record()}

    # --- the parts

    def _clean(self) -> dict:
        """Own clothing and untrained patterns from everywhere, and bare scenes."""
        unseen = self.lab.materials.unseen
        faces = self._areas[-1]
        noise = np.random.default_rng([self.lab.options.seed, 0xB1]).integers(0, 2, (len(faces), 1))
        colors = np.repeat(noise, 3, 1).astype(np.float32)
        worn = self._worn(colors, faces, Path("black and white"))
        views = len(CLEAN_ANGLES) * len(CLEAN_ELEVATIONS) * len(CLEAN_DISTANCES) * unseen.pose_count
        settings = {
            "elevations": CLEAN_ELEVATIONS,
            "distances": CLEAN_DISTANCES,
            "images_per_view": math.ceil(self.budget.clean_images / views),
            "most_images": self.budget.clean_images,
            "controls": (CLOTHING, "grey", "random", *NATURAL),
        }
        measured = self._evaluated("clean", [worn], CLEAN_ANGLES, settings).measurements[0]
        own, by = rows.clean(measured, self.own), rows.recall_by(measured, self.own)
        return {"clean": own, "recall_by": by, "controls": rows.controls(measured, self.own)}

    def _area(self, area: float, faces: np.ndarray) -> dict:
        """A cloak of this area, trained against the detector and judged from the front."""
        trained = [self._train(faces, seed, FRONT, self.budget.steps) for seed in self.lab.options.seed_list]
        result = self._evaluated(_name(area), trained, self.budget.front_angles, self._front())
        share = area_share(self.lab.materials.bodies, faces)
        label = {"asked": area, "area": round(share, 4), "faces": len(faces), "steps": self.budget.steps}
        return label | rows.attacked(result, self.spec, self.own)

    def _circle(self) -> dict:
        """The largest cloak, trained and judged all around."""
        steps = 2 * self.budget.steps
        trained = [self._train(self._areas[-1], seed, CIRCLE, steps) for seed in self.lab.options.seed_list]
        result = self._evaluated("circle", trained, self.budget.circle_angles, self._front())
        row = rows.attacked(result, self.spec, self.own)
        row |= {"by_angle": rows.by_angle(result, self.spec, self.own), "steps": steps}
        return {"circle": row["success"], "around": row}

    def _black_box(self) -> dict:
        """Cloaks that others were attacked with; those made against this very detector say so, and do not count."""
        materials, found = self.lab.materials, []
        for entry in self.entries:
            ids = load_logo(materials.unseen, entry["path"] / "logo.npy").face_ids
            worn = self._worn(read_colors(entry["path"] / "colors.npy", len(ids)), ids, entry["path"])
            part = f"zoo {entry['name']}"
            result = self._evaluated(part, [worn], self.budget.front_angles, self._front())
            unseen, _ = seen_in_training(entry["config"], materials.unseen, materials.unseen_backgrounds)
            white = trained_against(entry["config"], materials.detectors)[self.spec]
            label = {"name": entry["name"], "trained_against_it": white, "unseen": unseen}
            label["area"] = round(area_share(materials.unseen, ids), 4)
            found.append(label | rows.attacked(result, self.spec, self.own))
        counted = [row for row in found if not row["trained_against_it"]]
        worst = max(counted, key=lambda row: (row["success_own"], row["success"]), default=None)
        return {"zoo": found, "counted": len(counted), "worst": worst and worst["name"]} | {
            name: max((row[name] for row in counted), default=None) for name in ("success", "success_own")
        }

    def _front(self) -> dict:
        return {"images_per_view": self.budget.images_per_view, "controls": BESIDE}

    def _train(self, faces: np.ndarray, seed: int, angles: str, steps: int) -> Trained:
        return self.lab.train(faces, [self.spec], seed=seed, angles=angles, steps=steps)

    def _worn(self, colors: np.ndarray, faces: np.ndarray, name: Path) -> Trained:
        """Colours that were not trained here."""
        logo = make_logo(self.lab.materials.unseen, faces)
        return Trained(colors, logo, name, math.nan, math.nan, self.lab.train_settings())

    def _evaluated(self, part: str, trained: Sequence[Trained], angles: tuple[float, ...], settings: dict) -> Repeats:
        self.shown[part] = (trained[0], angles, settings)
        return self.lab.evaluate(trained, angles, **settings)

    def _not_tested(self, card: dict) -> list[str]:
        """What this card cannot say, for reasons of this detector or this call."""
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
        if not card["black_box"]["counted"]:
            others = (
                "the zoo holds none for this scene's bodies"
                if not self.entries
                else "those there are were made against it"
            )
            said.append(f"No cloak made against other detectors: {others}.")
        return said


def _name(area: float) -> str:
    return f"area {area:.0%}"
