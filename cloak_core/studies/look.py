"""Show one view of a body, cloaked and in its own clothing, to detectors; for programs that move a camera."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import get_type_hints

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.cameras import Camera
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluation import CLOTHING
from cloak_core.core.images import ImageSet, dressed
from cloak_core.core.logo import Cover, load_logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.pictures import save_picture
from cloak_core.core.settings.values import from_plain
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.cloth import CLOTH_FILE
from cloak_core.exchange.face_lists import read_colors
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_json, written
from cloak_core.patterns.controls import OwnClothing
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.source import BodySource
from cloak_core.studies.opening import run_pattern
from cloak_core.studies.report.pictures import reported, to_pil

ANSWER = "look.json"
CLOAK = "cloak"
LEAST_SCORE = 0.05
"""Boxes with a lower score are left out."""


@dataclass(frozen=True, kw_only=True)
class Look:
    """One view to look at. Lengths in metres, y up; angles in degrees; see `core.cameras.Camera`."""

    scene: str
    """As in cloak train."""
    out: str
    """Folder that takes the pictures and `look.json`, made where there is none; an earlier look's are replaced."""
    logo: str | None = None
    """Face list; None: nothing is worn but the body's own clothing."""
    colors: str | None = None
    """Colours of the logo's faces, .npy; None: the same."""
    cloth: str | None = None
    """Run folder whose cloth is worn in place of `colors`, as fine as it is printed; one without a cloth is ignored."""
    pose: int = 0
    outfit: int = 0
    azimuth: float = 0.0
    elevation: float = 6.0
    distance: float = 2.2
    field_of_view: float = 60.0
    """Vertical."""
    pivot: tuple[float, float, float] | None = None
    """The point looked at; None: the middle of the body."""
    width: int = 416
    height: int = 416
    backgrounds: str = "procedural:test"
    background: int = 0
    """Which of these; the numbers go around."""

    @staticmethod
    def of(record: Mapping[str, object]) -> Look:
        """Read a request from JSON. InputError names the key that is missing, unknown, or not of its kind."""
        kinds = get_type_hints(Look)
        unknown = sorted(record.keys() - kinds.keys())
        missing = sorted({"scene", "out"} - record.keys())
        if unknown or missing:
            raise InputError(f"a look has {'no key' if unknown else 'to have'} '{(unknown or missing)[0]}'")
        values = {name: from_plain(name, value, kinds[name]) for name, value in record.items() if name != "pivot"}
        pivot = record.get("pivot")
        if pivot is not None:
            if not isinstance(pivot, list) or len(pivot) != 3:
                raise InputError(f"pivot: {pivot!r} is not three numbers")
            values["pivot"] = tuple(from_plain("pivot", value, float) for value in pivot)
        return Look(**values)


class Looker:
    """Answer requests one after the other; keep the last scene and backgrounds open for the next."""

    def __init__(self, detectors: Mapping[str, Detector]) -> None:
        self._detectors = detectors
        self._device = next(iter(detectors.values())).device
        self._scene: tuple[object, BodySource] | None = None
        self._backdrops: tuple[str, Backgrounds] | None = None

    @torch.no_grad()
    def look(self, asked: Look) -> dict:
        """Render the view in own clothing and, where there are colours, cloaked; ask every detector; write pictures.

        Returns {"detectors": {SPEC: {"operating_point": x, "clothing": SEEN, "cloak": SEEN}}, "pictures": {"clothing":
        path, ...}, "width", "height", "seconds"}, SEEN = {"max_person": best score, "boxes": [[x1, y1, x2, y2, score],
        ...] in pixels, best first, those above `LEAST_SCORE`}; it lies in `look.json`, too. InputError: as for
        `evaluate`.
        """
        begun = time.monotonic()
        images = self._images(asked)
        folder = Path(asked.out)
        seen = {spec: {"operating_point": judge.operating_point} for spec, judge in self._detectors.items()}
        with written(folder):
            folder.mkdir(parents=True, exist_ok=True)
        pictures = {}
        for name, image in images.items():
            answer = reported(image, self._detectors, LEAST_SCORE)
            for spec, by_picture in seen.items():
                by_picture[name] = {"max_person": answer["scores"][spec], "boxes": answer["boxes"][spec]}
            pictures[name] = str(folder / f"{name}.png")
            save_picture(folder / f"{name}.png", to_pil(image[0]))
        result = {"detectors": seen, "pictures": pictures, "width": asked.width, "height": asked.height}
        result["seconds"] = round(time.monotonic() - begun, 3)
        write_json(folder / ANSWER, result)
        return result

    def _images(self, asked: Look) -> dict[str, Float[Tensor, "1 3 H W"]]:
        source = self._open(asked.scene)
        bodies = source.bodies
        if not 0 <= asked.pose < bodies.pose_count:
            raise InputError(f"pose {asked.pose}: scene '{bodies.name}' has {bodies.pose_count}")
        if asked.logo is None or asked.colors is None:
            # Without a cloak any face will do: it gets the colour that it has.
            patterns = {CLOTHING: OwnClothing(Cover(np.zeros(1, np.int64), bodies.topology))}
        else:
            cover = load_logo(bodies, asked.logo)
            patterns = {CLOTHING: OwnClothing(cover), CLOAK: _worn(asked, cover)}
        if self._backdrops is None or self._backdrops[0] != asked.backgrounds:
            self._backdrops = asked.backgrounds, load_backgrounds(asked.backgrounds)
        _, backdrops = self._backdrops
        camera = {field.name: getattr(asked, field.name) for field in fields(Camera) if hasattr(asked, field.name)}
        source = source.planned(None, Camera(**camera))
        source.on_cloth = any(pattern.needs_cloth for pattern in patterns.values())
        images = ImageSet(source, backdrops, (asked.height, asked.width), self._device)
        shown = {name: getattr(asked, name) for name in ("pose", "outfit", "azimuth", "elevation", "distance")}
        by_name = {}
        for name, pattern in patterns.items():
            views = images.make_views([(shown, None)], pattern)
            rows = images.backdrop(views, [asked.background % len(backdrops)])
            by_name[name] = dressed(views, pattern, rows).paint(pattern.colors_in(views[0], 0))
        return by_name

    def _open(self, spec: str) -> BodySource:
        files = [path for path in (Path(spec), Path(spec) / "bodies.npz") if path.exists()]
        key = (spec, tuple(path.stat().st_mtime_ns for path in files))
        if self._scene is None or self._scene[0] != key:
            settings = RenderSettings(device=self._device, memory_bytes=1 << 28)
            self._scene = key, BodySource(load_scene(spec), settings, Camera())
        return self._scene[1]


def _worn(asked: Look, cover: Cover) -> Pattern:
    """Read what a request wears: a run's cloth, else colours of faces, which Blender may have changed since."""
    if asked.cloth is not None and (Path(asked.cloth) / CLOTH_FILE).exists():
        return run_pattern(Path(asked.cloth), cover)
    return FacePattern(cover, colors=read_colors(Path(asked.colors), len(cover)))
