"""`cloak film`: a trained cloak in motion, and what detectors make of every frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from cloak_core.commands.base import out, share, table
from cloak_core.commands.options import OnUnseen, Watched
from cloak_core.commands.progress import counted
from cloak_core.core.evaluation.settings import FilmSettings
from cloak_core.files.writing import require_new


@dataclass(kw_only=True)
class Film(OnUnseen, Watched):
    """Film a trained cloak in motion beside its own clothing.

    The scene's poses in their order are the motion, again and again; the background stays as it is.
    """

    example = "runs/first --scene sample-clothed:unseen --out walk.mp4"
    then = "print {run_folder} --out sheets"
    next_why = "sheets to print and sew"

    out: Path
    """NAME.mp4 (extra film), NAME.gif, or a new folder for PNGs; every frame's figures stand beside it as .json."""
    colors: str | None = None
    """Film these colours on the run's logo instead, as in cloak evaluate."""
    logo: str | None = None
    """Regions or a face list that a cloth or picture covers, as in cloak evaluate."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """Detectors to watch with (default: those it was trained against)."""
    settings: Annotated[OmitArgPrefixes[FilmSettings], arg(name="film")] = field(default_factory=FilmSettings)

    def run(self) -> dict:
        from cloak_core.sources.bodies.videos import check_film

        self.prepare()
        require_new(self.out)
        check_film(self.out)
        from cloak_core.library import film
        from cloak_core.studies.trained_run import trained_specs

        folder, config = self.opened()
        detectors = self.by_spec(self.detector or trained_specs(folder, config))
        with counted("filming", self.events, "frames") as tell:
            how = {"colors": self.colors, "logo": self.logo, "settings": self.settings, "on_progress": tell}
            return film(self.run_folder, self.out, self.scene, self.backgrounds, detectors, **how)

    def show(self, result: dict) -> None:
        from cloak_core.studies.report.words import instead, percent

        for spec, told in result["detectors"].items():
            takes = "" if result["takes"] == 1 else f" in {result['takes']} takes"
            heads = ("", "at", "hidden", "renamed", "gone", "longest run", "first sight", "tracks")
            own = result["operating_points"][spec]
            rows = _rows(told, {"": result["threshold"], "_own": own})
            out.print(table(f"{spec}: {result['frames']} frames{takes}", heads, rows))
            logo = told["logo"]
            out.print(f"no person in {percent(logo['hidden'])} at {result['threshold']:g}{instead(logo)}")
        if result["left_out"]:
            out.print(f"in {result['left_out']} of {result['frames']} frames the body was not in the picture")
        out.print(f"wrote {result['out']} and {result['numbers']}")


def _rows(told: dict, thresholds: dict[str, float]) -> Iterator[tuple[str, ...]]:
    """Yield what is worn, a threshold, and the figures at it."""
    for control, x in told.items():
        for suffix, threshold in thresholds.items():
            shares = (share(x[f"{outcome}{suffix}"]) for outcome in ("hidden", "renamed", "gone"))
            sight = x[f"first_sight_m{suffix}"]
            metres = "–" if sight is None else f"{sight:.1f} m"
            tracks = str(x["tracks"]) if suffix else ""  # they are made at the detector's own threshold
            yield (control, f"{threshold:g}", *shares, str(x[f"longest_run{suffix}"]), metres, tracks)
