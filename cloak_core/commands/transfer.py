"""`cloak transfer`: what cloaks are worth against detectors that training never saw."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table
from tyro.conf import UseAppendAction

from cloak_core.commands.base import command_line, err, format_rate, out, table
from cloak_core.commands.options import Detecting, Splitting
from cloak_core.commands.progress import announce, shown_progress
from cloak_core.commands.sharing import Sharing
from cloak_core.core.settings.components import Hide
from cloak_core.files.errors import InputError, Stopped

if TYPE_CHECKING:
    from cloak_core.studies.transfer import TransferMatrix


CIRCLE_IMAGES = 240
"""Most test images of --circle."""


@dataclass(kw_only=True)
class Transfer(Splitting, Detecting, Sharing):
    """Train without each detector in turn, which then judges: a matrix for each ablation (--rungs).

    The same command goes on where it stopped, also after --budget-minutes (exit code 3).
    """

    example = "--detector onnx:a.onnx --detector onnx:b.onnx --detector onnx:c.onnx --out matrix"

    detector: UseAppendAction[tuple[str, ...]] = ()
    """Surrogates; each judged detector is left out of its own."""
    judge: UseAppendAction[tuple[str, ...]] = ()
    """Judged detectors (default: every --detector); others are never trained on."""
    logo: str = "shirt_trousers"
    """(or shirt_trousers, chest_thighs)"""
    out: Path
    """Folder for all results; what is there is not done again."""
    rungs: tuple[str, ...] = ("recipe",)
    """What to train: best, recipe (preset transfer), a technique upon best (score, smooth, animal, window, adaptive,
    cutout, blur, shake, mi, views), +NAME for all up to it, or ladder."""
    strangers_only: bool = False
    """Also leave detectors of the judged one's family out."""
    kin: UseAppendAction[tuple[str, ...]] = ()
    """PART_OF_A_SPEC=FAMILY, where names do not tell it (all YOLOs are one, and all R-CNNs)."""
    circle: bool = False
    """Train and judge all around, 1.4 to 6 m away (default: azimuths -10..10, 2.2 m)."""
    steps: int | None = None
    """(default: the preset's)"""
    seeds: int = 1
    """(default: 1)"""
    seed: int = 0
    batch: int | None = None
    """Images per update (default: the preset's)."""
    detectors_per_step: int | None = None
    hide: Hide = "person"
    size: int = 416
    images_per_view: int = 4
    most_images: int | None = None
    """(default: 240 with --circle, else all)"""
    budget_minutes: float | None = None
    """Stop after this many minutes in all; the same command continues."""
    publish: Path | None = None
    redraw: bool = False

    def run(self) -> dict:
        from cloak_core.studies.transfer import ablation_names, gather

        asked = ablation_names(self.rungs)
        stopped = ""
        if not self.redraw:
            try:
                self.sharing.spread(self._parts(asked), self.compute)
                self.work()
            except Stopped as stop:
                stopped = str(stop)
                if not (self.out / "cells").exists():
                    raise
        result = self._shown(gather(self.out), asked)
        return result | ({"stopped": stopped} if stopped else {})

    def work(self) -> None:
        """Fill the cells that are missing."""
        self.prepare()
        matrix = self._matrix()
        announce("transfer", *matrix.work(self.rungs), unit="trainings at most")
        with shown_progress(matrix.store):
            matrix.fill(self.rungs)

    def _parts(self, asked: tuple[str, ...]) -> list[tuple[str, Transfer]]:
        """Split the command by rung and by the judges that share its trainings, each with a name."""
        from cloak_core.studies.report.words import short_name

        if self.sharing.ray is None:
            return []
        alone = self.part_of(publish=None)
        # Who computes a part chooses its device; here detectors are only asked who they are.
        local = replace(self, compute=replace(self.compute, device="cpu")) if self.compute.device == "auto" else self
        groups = local._matrix().groups()
        return [
            (f"{name}, judged by {', '.join(map(short_name, group))}", replace(alone, rungs=(name,), judge=group))
            for name in asked
            for group in groups
        ]

    def _matrix(self) -> TransferMatrix:
        from cloak_core.core.evaluation.settings import StoreOptions
        from cloak_core.studies.store import RunStore
        from cloak_core.studies.transfer import CIRCLE, FRONT, PHOTOGRAPHS, TransferMatrix, families

        started = time.monotonic()
        if self.circle and self.people:
            raise InputError("--circle: of renders; photographs are seen from where they were taken")
        if not self.detector:
            raise InputError("--detector: none given; name several, for each is judged on the training without it")
        from cloak_core.detectors.naming import full_spec

        self.detector, self.judge = (tuple(map(full_spec, specs)) for specs in (self.detector, self.judge))
        detectors = self.by_spec((*self.detector, *self.judge))
        split = self.split(detectors)
        amount = {name: getattr(self, name) for name in ("seeds", "seed", "batch", "size", "images_per_view")}
        steps = () if self.steps is None else (self.steps,)
        options = StoreOptions(out=self.out, steps=steps, device=self.compute.device, **amount)
        cameras = PHOTOGRAPHS if self.people else CIRCLE if self.circle else FRONT
        training, test = dict(cameras.training), dict(cameras.test)
        if self.hide != "person":
            training["hide"] = self.hide
        if self.detectors_per_step:
            training["detectors_per_step"] = self.detectors_per_step
        if self.most_images or self.circle:
            test["most_images"] = self.most_images or CIRCLE_IMAGES
        return TransferMatrix(
            store=RunStore(split, options, err.print),
            faces=self._faces(split.bodies),
            logo=Path(self.logo).stem,
            surrogates=tuple(dict.fromkeys(self.detector)),
            judges=tuple(dict.fromkeys(self.judge or self.detector)),
            family=families(tuple(detectors), self.kin),
            cameras=replace(cameras, training=training, test=test),
            cross_family_only=self.strangers_only,
            deadline=None if self.budget_minutes is None else started + 60 * self.budget_minutes,
        )

    def _faces(self, bodies: object) -> object:
        from cloak_core.core.logo import chest_thighs, load_logo, shirt_trousers

        known = {"shirt_trousers": shirt_trousers, "chest_thighs": chest_thighs}
        return known[self.logo](bodies) if self.logo in known else load_logo(bodies, self.logo).face_ids

    def _shown(self, cells: list[dict], asked: tuple[str, ...]) -> dict:
        from cloak_core.studies.report.charts import group
        from cloak_core.studies.transfer import publish, show, summary

        name = self.out.resolve().name
        files = [*show(cells, self.out, name), publish(cells, self.out, name, name, command_line())]
        if self.publish is not None:
            files.append(publish(cells, self.publish, "transfer-matrix", name, command_line()))
        ladder = {name: summary(own) for name, own in group(cells, "rung").items()}
        last = next((ladder[name] for name in reversed(asked) if name in ladder), ladder[next(reversed(ladder))])
        return last | {"rungs": ladder, "files": [str(path) for path in files]}

    def show(self, result: dict) -> None:
        for name, summary in result["rungs"].items():
            out.print(_table(name, summary))
            images = " or ".join(str(n) for n in sorted({cell["n"] for cell in summary["matrix"].values()}))
            means = f"mean {summary['mean']:.2f}, worst {summary['worst']:.2f}; at 0.25 mean {summary['mean_025']:.2f}"
            out.print(f"{means}; {images} images each")
        for path in result["files"]:
            out.print(f"wrote {path}")

    def following(self, result: dict) -> tuple[str, ...]:
        named = [word for spec in self.detector for word in ("--detector", spec)]
        if self.people:
            beside = () if self.images is None else ("--images", str(self.images))
            worn = ("--preset", "photographs", "--people", self.people, *beside, "--logo", "shirt+trousers")
        else:
            worn = ("--preset", "transfer", "--logo", "chest+thighs")
        return ("train", *worn, *named, "--out", "runs/transfer")


def _table(ablation: str, summary: dict) -> Table:
    from cloak_core.studies.report.plots import MARKS
    from cloak_core.studies.report.words import short_name

    caption = f"{MARKS['stranger'].strip()} no sibling among its surrogates"
    title = f"{ablation}: success, judged by a detector that training left out"
    heads = ("judged by", "at 0.6", "95 %", "renamed", "gone", "own", "random", "clothing")
    rows = []
    for spec, cell in summary["matrix"].items():
        low, high = cell["ci95"]
        rest = (format_rate(cell[key]) for key in ("renamed", "gone", "success_own", "random", "clothing"))
        rows.append(
            (short_name(spec) + MARKS[cell["kin"]], format_rate(cell["success"]), f"{low:.2f}–{high:.2f}", *rest)
        )
    return table(title, heads, rows, caption=caption)
