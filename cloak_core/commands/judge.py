"""`cloak judge`: what detectors make of photographs and videos of people with and without a cloak."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from cloak_core.commands.base import out, share, table, warn
from cloak_core.commands.options import Detecting
from cloak_core.commands.progress import counted
from cloak_core.core.evaluation.settings import JudgeSettings
from cloak_core.files.errors import InputError


@dataclass(kw_only=True)
class Judge(Detecting):
    """Judge photographs and videos of people with and without a cloak.

    DIR has with/ and without/, PERSON/SCENE/file inside where known, and perhaps nobody/ and control garments; or
    pictures.csv. Only people who are found in the clean picture can be hidden.
    """

    example = "photographs --detector builtin"

    directory: Positional[Path]
    """Folder with with/ and without/ in it, or with pictures.csv."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """Detectors to judge with."""
    pictures: Path | None = None
    """CSV of the pictures instead (file and cloak; person, scene, distance, pair, x1, y1, x2, y2 where known)."""
    boxes: Path | None = None
    """CSV of people's boxes in upright pixels (file, x1, y1, x2, y2; person where a picture shows several)."""
    out: Path | None = None
    """Folder for report.html, summary.json and scores.csv (default: DIR/judge)."""
    settings: Annotated[OmitArgPrefixes[JudgeSettings], arg(name="judging")] = field(default_factory=JudgeSettings)

    def run(self) -> dict:
        self.prepare()
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
        for spec, told in result["detectors"].items():
            title = f"{spec}: who is found, and who is hidden though found in the clean picture"
            own = f"own {result['operating_points'][spec]:g}"
            out.print(table(title, ("", "hidden", "95 %", own, "of", "found", "95 %", "of"), _rows(told)))
            if told["n_nobody"]:
                out.print(f"false alarms in {told['n_nobody']} pictures of nobody: {told['false_alarms']:.1%}")
        for words in result["warnings"]:
            warn(words)
        counted = f"{result['pictures']} pictures, people: {result['people']}, scenes: {result['scenes']}"
        out.print(f"{counted}; wrote {result['report']}")


def _rows(told: dict) -> Iterator[tuple[str, ...]]:
    """Yield what is worn, who is hidden in it, and who is found."""
    for name, s in {"with": told["with"], **told["controls"], "without": told["without"]}.items():
        shares = share(s["conditional"]), _interval(s["ci95_conditional"]), share(s["conditional_own"])
        hidden = ("", "", "", "") if name == "without" else (*shares, str(s["n_conditional"]))
        yield (name, *hidden, share(s["detected"]), _interval(s["ci95_detected"]), str(s["n_all"]))


def _interval(bounds: tuple) -> str:
    return "–" if None in bounds else f"{bounds[0]:.2f}–{bounds[1]:.2f}"
