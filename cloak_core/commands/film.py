"""`cloak film` and `cloak export`: a trained cloak in motion, and renders of it for others' tools."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from cloak_core.commands.base import format_rate, out, table
from cloak_core.commands.options import Computing, OnUnseen, Watched
from cloak_core.commands.progress import counted
from cloak_core.core.evaluation.settings import EvaluateSettings, FilmSettings
from cloak_core.core.settings.values import Angles
from cloak_core.files.writing import require_new


@dataclass(kw_only=True)
class Film(OnUnseen, Watched):
    """Film a trained cloak in motion beside own clothing.

    The scene's poses in their order are the motion; the background stays.
    """

    example = "runs/first --scene sample-clothed:unseen --out walk.mp4"
    then = "print {run_folder} --out sheets"
    next_why = "sheets to print and sew"

    out: Path
    """NAME.mp4 (extra film), NAME.gif, or a new folder of PNGs; frames' figures go beside it, .json."""
    colors: str | None = None
    """Other colours, as in cloak evaluate."""
    logo: str | None = None
    detector: UseAppendAction[tuple[str, ...]] = ()
    """(default: those it was trained against)"""
    settings: Annotated[OmitArgPrefixes[FilmSettings], arg(name="film")] = field(default_factory=FilmSettings)

    def run(self) -> dict:
        from cloak_core.sources.bodies.videos import check_film

        self.prepare()
        require_new(self.out)
        check_film(self.out)
        from cloak_core.library.filming import film
        from cloak_core.studies.trained_run import trained_specs

        folder, config = self.opened()
        detectors = self.by_spec(self.detector or trained_specs(folder, config))
        with counted("filming", self.events, "frames") as tell:
            how = {"colors": self.colors, "logo": self.logo, "settings": self.settings, "on_progress": tell}
            return film(self.run_folder, self.out, self.scene, self.backgrounds, detectors, **how)

    def show(self, result: dict) -> None:
        from cloak_core.studies.report.words import instead, percent

        for spec, figures in result["detectors"].items():
            takes = "" if result["takes"] == 1 else f" in {result['takes']} takes"
            heads = ("", "at", "hidden", "renamed", "gone", "longest run", "first sight", "tracks")
            own = result["operating_points"][spec]
            rows = _rows(figures, {"": result["threshold"], "_own": own})
            out.print(table(f"{spec}: {result['frames']} frames{takes}", heads, rows))
            logo = figures["logo"]
            out.print(f"no person in {percent(logo['hidden'])} at {result['threshold']:g}{instead(logo)}")
        if result["left_out"]:
            out.print(f"in {result['left_out']} of {result['frames']} frames the body was not in the picture")
        out.print(f"wrote {result['out']} and {result['numbers']}")


def _rows(figures: dict, thresholds: dict[str, float]) -> Iterator[tuple[str, ...]]:
    """Yield what is worn, a threshold, and the figures at it."""
    for control, x in figures.items():
        for suffix, threshold in thresholds.items():
            shares = (format_rate(x[f"{outcome}{suffix}"]) for outcome in ("hidden", "renamed", "gone"))
            sight = x[f"first_sight_m{suffix}"]
            metres = "–" if sight is None else f"{sight:.1f} m"
            tracks = str(x["tracks"]) if suffix else ""  # they are made at the detector's own threshold
            yield (control, f"{threshold:g}", *shares, str(x[f"longest_run{suffix}"]), metres, tracks)


@dataclass(kw_only=True)
class Coco(OnUnseen, Computing):
    """Write renders of a run as a data set in COCO's format, in own clothing and cloaked."""

    example = "runs/first --out dataset"

    out: Path
    """New folder: images/ and annotations.json."""
    angles: Angles = Angles.parse("-10:10:5")
    format: Literal["jpg", "png"] = "jpg"
    """jpg (quality 95) or png (exact)."""
    images_per_view: int = 1
    most_images: int | None = None
    distances: tuple[float, ...] = (2.2,)
    elevations: tuple[float, ...] = (6.0,)
    size: int = 416
    shift: int | None = None
    """(default: an eighth of the size, at most 50)"""
    seed: int = 0

    def run(self) -> dict:
        from cloak_core.sources.backdrops.backgrounds import load_backgrounds
        from cloak_core.sources.bodies.opening import load_scene
        from cloak_core.studies.coco import export_coco
        from cloak_core.studies.imagery import drawn_images
        from cloak_core.studies.opening import open_run
        from cloak_core.studies.trained_run import kept_back

        self.prepare()
        folder, config = self.opened()
        bodies = load_scene(self.scene or kept_back("scene", config))
        pattern, _, _ = open_run(folder, config, None, bodies)
        backgrounds = load_backgrounds(self.backgrounds or kept_back("backgrounds", config))
        names = ("images_per_view", "most_images", "distances", "elevations", "size", "seed")
        shift = min(50, self.size // 8) if self.shift is None else self.shift
        settings = EvaluateSettings(shift=shift, **{name: getattr(self, name) for name in names})
        images = drawn_images(bodies, backgrounds, self.angles, settings, self.compute.device, [pattern])
        with counted("rendering") as tell:
            return export_coco(images, pattern, self.out, self.format, tell)

    def show(self, result: dict) -> None:
        out.print(f"wrote {result['file']}: {result['images']} images, {result['annotations']} annotations")
