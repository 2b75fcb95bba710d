"""`cloak reproduce`: the paper's tables and figures, and experiments of our own."""

from __future__ import annotations

import contextlib
import shlex
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from cloak_core.commands.base import err, out, warn
from cloak_core.commands.options import Computing, Splitting
from cloak_core.commands.sharing import Sharing, SharingOptions
from cloak_core.core.evaluation.settings import Internal
from cloak_core.experiments.options import Options, names
from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    from cloak_core.studies.store import RunStore

PARTS = 8
"""With --ray, the trainings of each experiment are split into this many parts."""


@dataclass(kw_only=True)
class Reproduce(Splitting, Computing, Sharing):
    """Run one of the paper's experiments, or all of them.

    Numbers and figures go to --out.
    """

    example = "table1 --quick --out runs/reproduce"

    name: Annotated[Positional[str], arg(help=f"{', '.join(names())} (render-gap needs Blender), or all.")]
    detector: UseAppendAction[tuple[str, ...]] = ()
    """Detectors, as in cloak train (default: builtin)."""
    publish: Path | None = None
    """Folder that takes the tables and figures of everything in --out as Markdown, tables.md."""
    redraw: bool = False
    """Train and evaluate nothing: draw figures again from the numbers in --out."""
    part: Internal[tuple[int, int]] = (0, 1)
    """Which part of how many `work` makes."""
    amount: Annotated[OmitArgPrefixes[Options], arg(name="experiments")] = field(default_factory=Options)

    def run(self) -> dict:
        from cloak_core.experiments.publish import make_page, publish

        done, skipped = self._redraw() if self.redraw else self._measure()
        published = {"published": str(publish(self.amount.out, self.publish))} if self.publish else {}
        return {"page": str(make_page(self.amount.out)), "experiments": done, "skipped": skipped} | published

    def _measure(self) -> tuple[dict, dict]:
        """Measure; give records by name, and why others were left out."""
        from cloak_core.experiments.runner import run_experiment
        from cloak_core.studies.cycles import NoBlender

        self.sharing.spread(self._parts(), self.compute)
        self.prepare()
        store = self._store()
        done, skipped = {}, {}
        for name in self._names():
            try:
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

        alone, parts = replace(self, sharing=SharingOptions(), publish=None), []
        for name in self._names():
            count = PARTS if name in experiments() and not experiments()[name].measure else 1
            every = [(f"{name}, {k + 1} of {count}", replace(alone, name=name, part=(k, count))) for k in range(count)]
            parts += every
        return parts

    def work(self) -> None:
        """Make the trainings and evaluations of a part of one experiment that are missing; write nothing of it."""
        from cloak_core.experiments.runner import find, measure_part
        from cloak_core.studies.cycles import NoBlender

        self.prepare()
        with contextlib.suppress(NoBlender):  # whoever gathers the parts says so
            measure_part(find(self.name), self._store(), *self.part)

    def _redraw(self) -> tuple[dict, dict]:
        """Draw again from the numbers alone, with what `_measure` gives."""
        from cloak_core.experiments.runner import draw_again, finished

        if self.name != "all":
            return {self.name: draw_again(self.name, self.amount.out)}, {}
        done, skipped = {}, {}
        for name in finished(self.amount.out):
            try:
                done[name] = draw_again(name, self.amount.out)
            except InputError as earlier:
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
        command = shlex.join(["cloak", *sys.argv[1:]])
        options = replace(self.amount, device=self.compute.device, command=command)
        return RunStore(split, options, lambda message: err.print(message))

    def show(self, result: dict) -> None:
        for name, record in result["experiments"].items():
            out.print(f"{name}: {record['title']}")
            for line in record["words"]:
                out.print(f"  {line}")
        for path in filter(None, (result["page"], result.get("published"))):
            out.print(f"wrote {path}")
