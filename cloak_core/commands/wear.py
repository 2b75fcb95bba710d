"""`cloak wear`, `cloak people`, `cloak judge`: real people in photographs, dressed here or by a tailor."""

from __future__ import annotations

import glob
import statistics
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from cloak_core.commands.base import Command, format_rate, left_out, out, table, warn
from cloak_core.commands.options import Detecting
from cloak_core.commands.progress import counted
from cloak_core.commands.sharing import executor_of
from cloak_core.core.evaluation.settings import JudgeSettings, WearSettings
from cloak_core.files.errors import InputError
from cloak_core.files.writing import require_new


@dataclass(kw_only=True)
class Wear(Detecting):
    """Dress the people in photographs in trained colours, and judge them.

    Photographs show real people: measure, publish no faces, identify nobody.
    """

    example = "zoo:builtin-sample --people people.json --detector builtin --out worn"

    colors: Positional[tuple[str, ...]]
    """A run, zoo:NAME, FILE.png@tile=METRES (cloth; auto: the width that hides best), FILE.png@patch=METRES (on the
    chest), '*.png@tile=0.5', a folder with patterns.toml, or print:NAME; @flipped at the end is upside down."""
    people: str
    images: Path | None = None
    logo: str | None = None
    detector: UseAppendAction[tuple[str, ...]] = ()
    width_people: str | None = None
    """With @tile=auto: people on whom the width is chosen, who do not judge."""
    width_detector: UseAppendAction[tuple[str, ...]] = ()
    """With @tile=auto: detectors that choose the width, and do not judge."""
    out: Path | None = None
    """New folder for pictures, a contact sheet and the table of scores."""
    backgrounds: str = "procedural:test"
    settings: Annotated[OmitArgPrefixes[WearSettings], arg(name="judging")] = field(default_factory=WearSettings)

    def run(self) -> dict:
        self.prepare()
        if not self.colors:
            raise InputError("wear: which colours? (a run, zoo:NAME, FILE.png@tile=0.5)")
        if not self.detector:
            raise InputError("--detector: none given")
        if self.out is not None:
            require_new(self.out)
        from cloak_core.library.wearing import wear

        detectors, choosers = self.by_spec(self.detector), self.by_spec(self.width_detector)
        with counted("dressing") as tell:
            colors = [one for color in self.colors for one in expanded(color)]
            how = {name: getattr(self, name) for name in ("images", "logo", "out", "settings", "width_people")}
            how |= {"width_detectors": choosers, "on_progress": tell}
            return wear(colors, self.people, detectors, self.backgrounds, **how)

    def show(self, result: dict) -> None:
        show_worn(result, self.settings.threshold)

    def following(self, result: dict) -> tuple[str, ...]:
        return ("assess", self.detector[0], "--people", self.people, "--out", "cards")


def expanded(color: str) -> list[str]:
    """List the pictures that a pattern folder, or *.png@tile=0.5, names; any other text as it is."""
    from cloak_core.studies.wearing.patterns import pattern_specs

    if (specs := pattern_specs(color)) != [color]:
        return specs
    pattern, _, form = color.rpartition("@")
    files = [] if Path(pattern).exists() else sorted(glob.glob(pattern))
    return [f"{file}@{form}" for file in files] or [color]


def show_worn(result: dict, threshold: float | int) -> None:
    """Show a table for each detector: who is not found in what."""
    from cloak_core.studies.report.words import most_named

    for spec, figures in result["detectors"].items():
        point = result["operating_points"][spec]
        heads = ("", f"at {threshold:g}", "95 %", f"own {point:g}", "renamed", "gone", "as")
        rows = []
        for name, s in figures.items():
            low, high = s["ci95"]
            rest = (format_rate(s[key]) for key in ("success_own", "renamed", "gone"))
            rows.append((name, format_rate(s["success"]), f"{low:.2f}–{high:.2f}", *rest, most_named(s)))
        out.print(table(f"{spec}: share of people who are not found", heads, rows))
    for color, curve in result.get("widths", {}).items():
        on = f"{curve['people']} people and {', '.join(curve['detectors'])}, who do not judge"
        out.print(f"{color}: {curve['chosen']:g} m wide, chosen on {on}")
    show_people(result)
    if "out" in result:
        out.print(f"wrote {result['out']} (pictures, scores.csv); look at {Path(result['out']) / 'sheet.jpg'} first")


SEEN = {True: "; training saw none of these photographs", False: "; training saw some of these photographs"}


def show_people(result: dict) -> None:
    """Say who was judged, who was left out, and whether training saw these photographs."""
    seen = SEEN.get(result.get("unseen", {}).get("photographs"), "")
    out.print(f"{result['people']} people in {result['photographs']} photographs; left out: {left_out(result)}{seen}")


@dataclass(kw_only=True)
class Fit(Command):
    """Fit bodies to the people in photographs, and count them.

    Other commands do so on their own; fits are kept in the cache (CLOAK_CACHE), by content.
    """

    example = "people.json"

    people: Positional[str]
    images: Path | None = None
    ray: str | None = None

    def run(self) -> dict:
        from cloak_core.sources.photographs.fits import fit_people, those_who_fit
        from cloak_core.sources.photographs.people import load_people

        people, executor = load_people(self.people, self.images), executor_of(self.ray)
        with counted("fitting", unit="people") as tell:
            fits = fit_people(people, tell, executor)
        fitting, qualities = those_who_fit(people, fits), list(fits.qualities())
        return {
            "people": len(fitting),
            "photographs": len(fitting.photographs),
            "left_out": fitting.left_out,
            "covered": statistics.median(quality["covered"] for quality in qualities),
            "spilled": statistics.median(quality["spilled"] for quality in qualities),
        }

    def show(self, result: dict) -> None:
        out.print(f"{result['people']} people in {result['photographs']} photographs; left out: {left_out(result)}")
        out.print(f"the body covers {result['covered']:.0%} of a person, {result['spilled']:.0%} of it lies beside her")

    def following(self, result: dict) -> tuple[str, ...]:
        return ("train", "--people", self.people, *(("--images", str(self.images)) if self.images else ()))


@dataclass(kw_only=True)
class Judge(Detecting):
    """Judge photographs and videos of people with and without a cloak.

    DIR has with/ and without/ (PERSON/SCENE/file inside where known), perhaps nobody/ and control garments; or
    pictures.csv. Only people who are found in the clean picture can be hidden.
    """

    example = "photographs --detector builtin"

    directory: Positional[Path]
    """Folder with with/ and without/, or with pictures.csv."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    pictures: Path | None = None
    """CSV of the pictures instead (file and cloak; person, scene, distance, pair, x1, y1, x2, y2 where known)."""
    boxes: Path | None = None
    """CSV of people's boxes in upright pixels (file, x1, y1, x2, y2; person where there are several)."""
    out: Path | None = None
    """Folder for report.html, summary.json, scores.csv (default: DIR/judge)."""
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
        for spec, figures in result["detectors"].items():
            title = f"{spec}: who is found, and who is hidden though found in the clean picture"
            own = f"own {result['operating_points'][spec]:g}"
            out.print(table(title, ("", "hidden", "95 %", own, "of", "found", "95 %", "of"), _rows(figures)))
            if figures["n_nobody"]:
                out.print(f"false alarms in {figures['n_nobody']} pictures of nobody: {figures['false_alarms']:.1%}")
        for words in result["warnings"]:
            warn(words)
        counted = f"{result['pictures']} pictures, people: {result['people']}, scenes: {result['scenes']}"
        out.print(f"{counted}; wrote {result['report']}")


def _rows(figures: dict) -> Iterator[tuple[str, ...]]:
    """Yield what is worn, who is hidden in it, and who is found."""
    for name, s in {"with": figures["with"], **figures["controls"], "without": figures["without"]}.items():
        shares = format_rate(s["conditional"]), _interval(s["ci95_conditional"]), format_rate(s["conditional_own"])
        hidden = ("", "", "", "") if name == "without" else (*shares, str(s["n_conditional"]))
        yield (name, *hidden, format_rate(s["detected"]), _interval(s["ci95_detected"]), str(s["n_all"]))


def _interval(bounds: tuple) -> str:
    return "–" if None in bounds else f"{bounds[0]:.2f}–{bounds[1]:.2f}"
