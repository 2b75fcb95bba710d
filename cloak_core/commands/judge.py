"""`cloak judge`: what detectors make of photographs and videos of people with and without a cloak."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from rich.table import Table
from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from cloak_core.commands.base import out, share, warn
from cloak_core.commands.options import Detecting
from cloak_core.commands.progress import counted
from cloak_core.core.evaluation.settings import JudgeSettings
from cloak_core.files.errors import InputError


@dataclass(kw_only=True)
class Judge(Detecting):
    """Judge photographs and videos of people with and without a cloak.

    DIR has with/ and without/, PERSON/SCENE/file inside as far as that is known, and where there are some, nobody/ and
    control garments; or pictures.csv, which says who is in which picture. A person whom the clean picture misses is
    never a success.
    """

    example = "photographs --detector builtin"

    directory: Positional[Path | None] = None
    """Folder with with/ and without/ in it, or with pictures.csv."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """Detectors to judge with."""
    pictures: Path | None = None
    """CSV of the pictures instead (file and cloak; person, scene, distance, pair, x1, y1, x2, y2 where known)."""
    boxes: Path | None = None
    """CSV of people's boxes in upright pixels (file, x1, y1, x2, y2; person where a picture shows several)."""
    out: Path | None = None
    """Folder for report.html, summary.json and scores.csv (default: DIR/judge)."""
    plan: bool = False
    """Judge nothing; print how wide intervals will be for numbers of people, scenes and pictures."""
    settings: Annotated[OmitArgPrefixes[JudgeSettings], arg(name="judging")] = field(default_factory=JudgeSettings)

    def run(self) -> dict:
        self.prepare()
        if self.plan:
            from cloak_core.studies.statistics_photographs import RATES, independent_pairs, plan

            return {"plan": plan(), "independent": {f"{rate:g}": independent_pairs(rate) for rate in RATES}}
        if self.directory is None:
            raise InputError("judge: which folder?")
        if not self.detector:
            raise InputError("--detector: none given")
        from cloak_core.studies.judging.judge import judge

        with counted("looking") as tell:
            return judge(
                self.directory,
                self.by_spec(self.detector),
                self.settings,
                table=self.pictures,
                boxes=self.boxes,
                out=self.out or self.directory / "judge",
                on_progress=tell,
            )

    def show(self, result: dict) -> None:
        if "plan" in result:
            return show_plan(result)
        for spec, told in result["detectors"].items():
            out.print(_table(spec, told, result))
            if told["n_nobody"]:
                out.print(f"false alarms in {told['n_nobody']} pictures of nobody: {told['false_alarms']:.1%}")
        for words in result["warnings"]:
            warn(words)
        counted = f"{result['pictures']} pictures, people: {result['people']}, scenes: {result['scenes']}"
        out.print(f"{counted}; wrote {result['report']}")


def _table(spec: str, told: dict, result: dict) -> Table:
    table = Table(title=f"{spec}: who is found, and who is hidden though found in the clean picture")
    own = f"own {result['operating_points'][spec]:g}"
    for head in ("", "hidden", "95 %", own, "of", "found", "95 %", "of"):
        table.add_column(head, justify="right" if head else "left", min_width=9 if head == "95 %" else None)
    for name, s in {"with": told["with"], **told["controls"], "without": told["without"]}.items():
        found = share(s["detected"]), _interval(s["ci95_detected"]), str(s["n_all"])
        hidden = ("", "", "", "")
        if name != "without":
            shares = share(s["conditional"]), _interval(s["ci95_conditional"]), share(s["conditional_own"])
            hidden = (*shares, str(s["n_conditional"]))
        table.add_row(name, *hidden, *found)
    return table


def _interval(bounds: tuple) -> str:
    return "–" if None in bounds else f"{bounds[0]:.2f}–{bounds[1]:.2f}"


def show_plan(result: dict) -> None:
    """Show half widths of 95 % intervals, in points."""
    rates = list(result["independent"])
    table = Table(title="half of the 95 % interval, points")
    for head in ("people", "scenes", "pairs of each in each", "pairs in all", *(f"rate {rate}" for rate in rates)):
        table.add_column(head, justify="right")
    for row in result["plan"]:
        counts = (str(row[key]) for key in ("people", "scenes", "each", "pairs"))
        table.add_row(*counts, *(f"±{row['points'][rate]:.0f}" for rate in rates))
    out.print(table)
    said = ", ".join(f"{count} at a rate of {rate}" for rate, count in result["independent"].items())
    out.print(f"±10 points from pairs that have no person and no scene in common: {said}")
    for words in PLAN_WORDS:
        out.print(words)


PLAN_WORDS = (
    "An interval speaks of people and scenes that were not photographed, so the number of these decides: a second",
    "picture of the same person in the same scene says little new. From one person or two it cannot be known how much",
    "people differ; such an interval is too narrow and speaks of these people alone. So it may widen when the first",
    "few are added, and the wider one is the honest one. Aim for 8 people in 8 scenes.",
)
