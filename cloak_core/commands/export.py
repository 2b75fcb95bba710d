"""`cloak export`: renders for others' tools."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cloak_core.commands.base import out
from cloak_core.commands.options import Computing, OnUnseen
from cloak_core.commands.progress import counted
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.settings.values import Angles


@dataclass(kw_only=True)
class Coco(OnUnseen, Computing):
    """Write renders of a run as a data set in COCO's format, each in own clothing and cloaked."""

    example = "runs/first --out dataset"

    out: Path
    """New folder: images/ and annotations.json."""
    angles: Angles = Angles.parse("-10:10:5")
    """Azimuths in degrees: A:B:STEP or a comma list."""
    format: Literal["jpg", "png"] = "jpg"
    """Of the images; jpg is written with quality 95, png is exact."""
    images_per_view: int = 1
    """Images (background, shift, outfit) of every body at every angle, elevation and distance."""
    most_images: int | None = None
    """At most this number of them, drawn by the seed; each is written twice."""
    distances: tuple[float, ...] = (2.2,)
    """Camera distances, metres."""
    elevations: tuple[float, ...] = (6.0,)
    """Camera elevations, degrees."""
    size: int = 416
    """Width and height of the images, pixels."""
    shift: int | None = None
    """The body is moved by up to this many pixels along both axes (default: an eighth of the size, at most 50)."""
    seed: int = 0
    """Every random draw derives from it."""

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
