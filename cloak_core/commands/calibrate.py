"""`cloak calibrate`: what a printer and a camera make of colours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import UseAppendAction

from cloak_core.commands.base import Command, out
from cloak_core.files.errors import InputError


@dataclass(kw_only=True)
class Calibrate(Command):
    """Measure which colours a printer and a camera make: a profile.

    First --chart, to print as the cloak will be printed; then its photograph (or measured patches) with --measured.
    """

    example = "--measured photo.jpg --out printer.npz"

    chart: Path | None = None
    """Write the chart here (.pdf, or .png for services that take no PDF), and a .csv of its patches beside it."""
    measured: UseAppendAction[tuple[Path, ...]] = ()
    """A photograph of the printed chart (several are averaged), a .csv of measured patches, or the printer's ICC
    profile (.icc, .icm)."""
    out: Path | None = None
    """Profile to write (.npz)."""

    def run(self) -> dict:
        from cloak_core.output.calibration.chart import patch_colors, write_chart
        from cloak_core.output.calibration.fitting import profile_of

        if bool(self.measured) != (self.out is not None):
            raise InputError("--measured and --out: one needs the other")
        if self.chart is None and not self.measured:
            raise InputError("--chart FILE.pdf writes the chart; --measured PHOTOGRAPH --out FILE.npz reads it")
        if self.chart is not None:
            write_chart(self.chart)
        if self.out is None:
            return {"chart": str(self.chart), "patches": len(patch_colors())}
        figures = profile_of(self.measured, self.out).figures
        told = {name: round(figures[name], 3) for name in ("de2000_before", "de2000_after")}
        chart = {"chart": str(self.chart)} if self.chart else {}
        return chart | {"profile": str(self.out), **told, "patches": int(figures["patches"])}

    def show(self, result: dict) -> None:
        if "chart" in result:
            out.print(
                f"wrote {result['chart']}: print it at 100 %, as the cloak will be printed, and photograph it flat"
            )
        if "profile" in result:
            before, after = result["de2000_before"], result["de2000_after"]
            out.print(f"wrote {result['profile']}, from {result['patches']} patches")
            out.print(f"CIEDE2000 between sent and seen {before:.1f}; between foretold and seen {after:.1f}")
