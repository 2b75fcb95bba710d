"""`cloak reproduce`: the paper's tables and figures, and experiments of our own."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.table import Table
from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from cloak_core.commands.base import command_line, err, out, warn
from cloak_core.commands.options import Computing, Splitting
from cloak_core.commands.progress import announce, shown_progress
from cloak_core.commands.sharing import Sharing
from cloak_core.core.evaluation.settings import Internal
from cloak_core.experiments.options import EXPERIMENTS, Options
from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    from cloak_core.studies.report.charts import Rows
    from cloak_core.studies.store import RunStore

PARTS = 8
"""With --ray, the trainings of each experiment are split into this many parts."""


@dataclass(kw_only=True)
class Reproduce(Splitting, Computing, Sharing):
    """Run one of the paper's experiments, or all, into --out."""

    example = "table1 --quick --out runs/reproduce"

    name: Annotated[Positional[str], arg(help=f"{', '.join(EXPERIMENTS)} (render-gap needs Blender), or all.")] = ""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """(default: builtin)"""
    list: bool = False
    """List the experiment's rows (all without NAME), with updates and time; make nothing."""
    only: UseAppendAction[tuple[str, ...]] = ()
    """Make only this row, by number or words of its name (--list), and print its figures."""
    publish: Path | None = None
    redraw: bool = False
    part: Internal[tuple[int, int]] = (0, 1)
    """Which part of how many `work` makes."""
    amount: Annotated[OmitArgPrefixes[Options], arg(name="experiments")] = field(default_factory=Options)

    def run(self) -> dict:
        if not self.name:
            if not self.list:
                raise InputError(
                    "reproduce: needs NAME; cloak reproduce --list shows what there is and how long it takes"
                )
            self.name = "all"
        if self.list or self.only:
            return self._planned() if self.list else self._rows()
        from cloak_core.experiments.publish import make_page, publish

        done, skipped = self._redraw() if self.redraw else self._measure()
        published = {"published": str(publish(self.amount.out, self.publish))} if self.publish else {}
        return {"page": str(make_page(self.amount.out)), "experiments": done, "skipped": skipped} | published

    def _planned(self) -> dict:
        """List the rows of the experiments that have any, and how long each takes."""
        self.prepare()
        store = self._store()
        rows = {name: self._planned_rows(name, store, self.name != "all") for name in self._names()}
        return {"page": "", "experiments": {}, "skipped": {}, "plan": rows}

    @staticmethod
    def _planned_rows(name: str, store: RunStore, are_needed: bool = False) -> list[dict]:
        """List the rows of an experiment; none where it has none. InputError: some `are_needed`."""
        from cloak_core.experiments.runner import find, plan

        try:
            return [vars(row) for row in plan(find(name), store)]
        except InputError:
            if are_needed:
                raise
            return []

    def _rows(self) -> dict:
        """Make the chosen rows of one experiment, for `reproduce` without --only to find."""
        from cloak_core.experiments.runner import chosen, find, measure_rows, paper_rows

        if self.name == "all":
            raise InputError("--only: names rows of one experiment, not of all")
        if self.publish:
            raise InputError("--publish: takes whole experiments; --only prints its rows, with --json for a program")
        self.prepare()
        store, experiment = self._store(), find(self.name)
        with shown_progress(store):
            rows = measure_rows(chosen(experiment, store, self.only), store)
        return {"page": "", "experiments": {}, "skipped": {}, "rows": rows, "paper": paper_rows(experiment, rows)}

    def _measure(self) -> tuple[dict, dict]:
        """Measure; give records by name, and why others were left out."""
        from cloak_core.experiments.runner import find, run_experiment
        from cloak_core.sources.bodies.blender.outside import NoBlender

        self.sharing.spread(self._parts(), self.compute)
        self.prepare()
        store = self._store()
        done: dict[str, dict] = {}
        skipped: dict[str, str] = {}
        for name in self._names():
            try:
                if rows := self._planned_rows(name, store):
                    announce(name, len(rows), sum(row["seconds"] for row in rows), unit="rows")
                else:
                    err.print(f"{name}: {find(name).title}")
                with shown_progress(store):
                    done[name] = run_experiment(name, store)
            except NoBlender as missing:
                if self.name != "all":
                    raise
                warn(f"{missing}; left out")
                skipped[name] = str(missing)
        return done, skipped

    def _parts(self) -> list[tuple[str, Reproduce]]:
        """Split the command by experiment, and each of them by its cells."""
        from cloak_core.experiments.runner import experiments

        parts = []
        for name in self._names():
            count = PARTS if name in experiments() and not experiments()[name].measure else 1
            for k in range(count):
                parts.append((f"{name}, {k + 1} of {count}", self.part_of(publish=None, name=name, part=(k, count))))
        return parts

    def work(self) -> None:
        """Make the trainings and evaluations of a part of one experiment that are missing; write nothing of it."""
        from cloak_core.experiments.runner import find, measure_part
        from cloak_core.sources.bodies.blender.outside import NoBlender

        self.prepare()
        with contextlib.suppress(NoBlender):  # whoever gathers the parts says so
            measure_part(find(self.name), self._store(), *self.part)

    def _redraw(self) -> tuple[dict, dict]:
        """Draw again from the numbers alone, with what `_measure` gives."""
        from cloak_core.experiments.runner import draw_again, finished

        done: dict[str, dict] = {}
        skipped: dict[str, str] = {}
        for name in finished(self.amount.out) if self.name == "all" else [self.name]:
            try:
                done[name] = draw_again(name, self.amount.out)
            except InputError as earlier:
                if self.name != "all":
                    raise
                warn(f"{earlier}; left as it is")
                skipped[name] = str(earlier)
        return done, skipped

    def _names(self) -> list[str]:
        from cloak_core.experiments.runner import experiments

        return list(experiments()) if self.name == "all" else [self.name]

    def _store(self) -> RunStore:
        from cloak_core.detectors.loading import load_detector
        from cloak_core.studies.store import RunStore

        specs = self.detector or ("builtin",)
        split = self.split({spec: load_detector(spec, device=self.compute.device) for spec in specs})
        options = replace(self.amount, device=self.compute.device, command=command_line())
        return RunStore(split, options, err.print)

    def show(self, result: dict) -> None:
        from cloak_core.studies.report.words import duration

        for name, rows in result.get("plan", {}).items():
            whole = sum(row["seconds"] for row in rows)
            out.print(f"{name}: {len(rows)} rows, about {duration(whole)}" if rows else f"{name}: without rows")
            for row in rows:
                out.print(
                    f"  {row['number']:>2}  {row['name']}: {row['updates']} updates, about {duration(row['seconds'])}"
                )
        for title, rows in {"Made here": "rows", "In the paper": "paper"}.items():
            show_rows(title, result.get(rows, []))
        for name, record in result["experiments"].items():
            out.print(f"{name}: {record['title']}")
            for line in record["words"]:
                out.print(f"  {line}")
        for path in filter(None, (result["page"], result.get("published"))):
            out.print(f"wrote {path}")

    def following(self, result: dict) -> tuple[str, ...]:
        ordered = tuple(EXPERIMENTS)
        later = ordered[ordered.index(self.name) + 1 :] if self.name in ordered else []
        return ("reproduce", later[0], "--list") if later and not self.list else ()


def show_rows(title: str, rows: Rows) -> None:
    """Show the rows of an experiment beside each other, with a line for each of their columns."""
    from cloak_core.experiments.publish import readable

    frame = readable(rows)
    if rows:
        table = Table(title=title, title_justify="left", show_header=False)
        for line in zip(frame["heads"], *frame["rows"], strict=True):
            table.add_row(*line)
        out.print(table)
