"""`cloak print`: the trained colours onto cloth; `cloak calibrate`: what a printer and a camera make of colours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import UseAppendAction

from cloak_core.commands.base import Command, out
from cloak_core.commands.options import AboutRun
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.opening import load_scene


@dataclass(kw_only=True)
class Print(AboutRun):
    """Lay a logo out flat at true size: sheets to print and cut (PDF), its texture and body (GLB, OBJ)."""

    example = "runs/first --out sheets"

    out: Path
    """New folder to write."""
    scene: str | None = None
    """(default: what the run was trained on; its first pose)"""
    dpi: int = 150
    page: Literal["A4", "A3", "Letter", "Tabloid"] = "A4"
    """Paper of the sheets."""
    pieces: Literal["cut", "own"] = "cut"
    """Pieces cut anew with little stretch, or the mesh's own UV map, as a garment has it."""
    allowance_cm: float = 0.0
    """Cloth around each piece for sewing, centimetres; marks along seams match anyway."""
    project: bool = False
    """Replace colours that a four-colour printer cannot mix (or --palette lacks) by the nearest."""
    palette: Path | None = None
    profile: Path | None = None
    """Profile (`cloak calibrate`): sheets have the colours to send so that the run's come out."""

    def run(self) -> dict:
        from cloak_core.exchange.profiles import read_profile
        from cloak_core.products.printing import print_pattern
        from cloak_core.sources.bodies.logos.palette import read_palette
        from cloak_core.studies.opening import open_run

        if self.palette is not None and self.profile is not None:
            raise InputError("--palette and --profile: either tells which colours there are")
        profile = None if self.profile is None else read_profile(self.profile)
        palette = None if self.palette is None else read_palette(self.palette)
        folder, config = self.opened()
        scene = self.scene or config.get("inputs", {}).get("scene")
        if not scene:
            raise InputError("--scene: say which body (the run does not record it)")
        bodies = load_scene(scene)
        pattern, _, _ = open_run(folder, config, None, bodies)
        how = {"title": folder.resolve().name, "palette": palette, "project": self.project, "profile": profile}
        how |= {"own_pattern": self.pieces == "own", "allowance": self.allowance_cm / 100}
        report = print_pattern(bodies, pattern, self.out, dpi=self.dpi, page=self.page, **how)
        return {"out": str(self.out)} | report

    def show(self, result: dict) -> None:
        out.print(f"wrote {result['out']}")
        for words in report_sentences(result):
            out.print(words)


def report_sentences(report: dict) -> list[str]:
    """Describe a print's report in sentences, with what to do about what will not come out."""
    width, height = (100 * extent for extent in report["sheet_m"])
    words = [
        f"{report['charts']} pieces, together {width:.0f} x {height:.0f} cm, on {report['pages']} pages of "
        f"{report['page']}; the first is an overview",
        f"laid flat, lengths are {report['stretch_mean'] - 1:.1%} off in the mean, and at most "
        f"{report['stretch_99'] - 1:.0%} off on 99 % of the cloth",
        f"{report['marks']} marks along seams; sizes are those of the pose '{report['pose']}'",
    ]
    share = f"{report['unprintable_colors']:,} of {report.get('colors', report['faces']):,} colours"
    if report["unprintable_colors"] and report["projected"]:
        words.append(f"{share} could not come out, and were replaced by the nearest that can")
    elif report["unprintable_colors"]:
        words.append(
            f"{share} cannot be mixed by a four-colour printer and will come out duller: --project replaces them by "
            "the nearest that can (evaluate those: cloak evaluate --profile, after cloak calibrate), or train with "
            "--profile"
        )
    return words


@dataclass(kw_only=True)
class Calibrate(Command):
    """Measure which colours a printer and a camera make: a profile.

    First --chart, printed as the cloak will be; then its photograph (or measured patches) with --measured.
    """

    example = "--measured photo.jpg --out printer.npz"

    chart: Path | None = None
    """Chart to write (.pdf or .png), with a .csv of its patches."""
    measured: UseAppendAction[tuple[Path, ...]] = ()
    """Photograph of the printed chart (several: averaged), .csv of patches, or ICC profile (.icc, .icm)."""
    out: Path | None = None
    """Profile to write (.npz)."""

    def run(self) -> dict:
        from cloak_core.products.calibration import profile_of
        from cloak_core.products.chart import patch_colors, write_chart

        if bool(self.measured) != (self.out is not None):
            raise InputError("--measured and --out: one needs the other")
        if self.chart is None and not self.measured:
            raise InputError("--chart FILE.pdf writes the chart; --measured PHOTOGRAPH --out FILE.npz reads it")
        if self.chart is not None:
            write_chart(self.chart)
        if self.out is None:
            return {"chart": str(self.chart), "patches": len(patch_colors())}
        figures = profile_of(self.measured, self.out).figures
        differences = {name: round(figures[name], 3) for name in ("de2000_before", "de2000_after")}
        chart = {"chart": str(self.chart)} if self.chart else {}
        return chart | {"profile": str(self.out), **differences, "patches": int(figures["patches"])}

    def show(self, result: dict) -> None:
        if "chart" in result:
            out.print(
                f"wrote {result['chart']}: print it at 100 %, as the cloak will be printed, and photograph it flat"
            )
        if "profile" in result:
            before, after = result["de2000_before"], result["de2000_after"]
            out.print(f"wrote {result['profile']}, from {result['patches']} patches")
            out.print(f"CIEDE2000 between sent and seen {before:.1f}; between foretold and seen {after:.1f}")
