"""`cloak logo ...`: which faces the cloak may colour."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from cloak_core.commands.base import Command, out
from cloak_core.commands.options import Watched
from cloak_core.commands.progress import counted
from cloak_core.core.settings.values import Angles
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.face_lists import write_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.writing import require_new
from cloak_core.sources.bodies.opening import load_scene


def write_logo(path: Path, bodies: Bodies, ids: np.ndarray) -> dict:
    from cloak_core.core.logo import area_share

    write_face_list(path, ids, bodies.topology)
    return {"faces": len(ids), "area_share": round(float(area_share(bodies, ids)), 5), "out": str(path)}


def show_logo(result: dict) -> None:
    out.print(f"wrote {result['out']}: {result['faces']} faces, {result['area_share']:.1%} of the body's area")


@dataclass(kw_only=True)
class Select(Command):
    """Take faces by region or by box into a face list (.npy)."""

    example = "--scene sample --region chest+thighs --out chest.npy"

    scene: str
    out: Path
    """Face list to write, with its sidecar .json."""
    region: str | None = None
    """Regions joined by +, such as chest+thighs (cloak scene info lists them)."""
    box: str | None = None
    """x0,x1,y0,y1,z0,z1, metres in the first pose: faces whose centre lies inside."""
    facing: Literal["front", "back", "left", "right", "any"] = "any"
    """With --box: only faces whose normal points that way."""

    def run(self) -> dict:
        from cloak_core.core.logo import select_box, select_region

        if (self.region is None) == (self.box is None):
            raise InputError("logo select: give either --region or --box")
        require_new(self.out)
        bodies = load_scene(self.scene)
        ids = select_box(bodies, parse_box(self.box), self.facing) if self.box else select_region(bodies, self.region)
        return write_logo(self.out, bodies, ids)

    show = staticmethod(show_logo)


def parse_box(text: str) -> tuple[float, ...]:
    try:
        box = tuple(float(part) for part in text.split(","))
    except ValueError:
        box = ()
    if len(box) != 6 or not np.isfinite(box).all() or any(a >= b for a, b in zip(box[::2], box[1::2], strict=True)):
        raise InputError(f"--box {text}: six numbers x0,x1,y0,y1,z0,z1 are needed, each pair rising")
    return box


@dataclass(kw_only=True)
class Project(Command):
    """Stamp a text or a picture on the chest, and take the faces it covers."""

    example = "--scene sample --text G --out letter.npy"

    scene: str
    out: Path
    """Face list to write, with its sidecar .json."""
    text: str | None = None
    """Text to stamp, such as G."""
    mask: Path | None = None
    """Picture to stamp: its opaque pixels where it has transparency, else its dark ones."""
    height: float | None = None
    """Height of the stamp, metres (default: fits the chest)."""
    center: tuple[float, float] | None = None
    """Centre x y of the stamp, metres in the first pose (default: the chest's)."""

    def run(self) -> dict:
        from cloak_core.sources.bodies.logos.stamping import project_mask, project_text

        if (self.text is None) == (self.mask is None):
            raise InputError("logo project: give either --text or --mask")
        require_new(self.out)
        bodies = load_scene(self.scene)
        project, ink = (project_mask, self.mask) if self.text is None else (project_text, self.text)
        return write_logo(self.out, bodies, project(bodies, ink, height=self.height, center=self.center))

    show = staticmethod(show_logo)


@dataclass(kw_only=True)
class Heatmap(Watched):
    """Measure how much each face moves a detector's person score."""

    example = "--scene sample:train --detector builtin --pick 0.2 --out heat.npy"

    scene: str
    detector: str
    out: Path
    """Heat map to write: a float32 per face (.npy)."""
    backgrounds: str = "procedural:train"
    angles: Angles = Angles.parse("-10:10:5")
    pick: float | None = None
    """Also take the most sensitive faces, this share of the body's area, into a face list."""
    logo: Path | None = None
    """Face list of --pick (default: NAME-pick.npy beside the heat map)."""

    def run(self) -> dict:
        from cloak_core.core.geometry import face_areas
        from cloak_core.exchange.face_lists import hottest_faces
        from cloak_core.files.writing import write_npy
        from cloak_core.sources.backdrops.backgrounds import load_backgrounds
        from cloak_core.studies.trainings.heatmap import heatmap

        self.prepare()
        logo = self.logo or self.out.with_name(self.out.stem + "-pick.npy")
        if self.pick is not None and not 0 < self.pick <= 1:
            raise InputError(f"--pick {self.pick}: a share of the area in (0, 1] is needed")
        for path in [self.out] + [logo] * (self.pick is not None):
            require_new(path)
        bodies = load_scene(self.scene)
        detector = self.load(self.detector)
        with counted("measuring heat", self.events) as tell:
            heat = heatmap(bodies, detector, load_backgrounds(self.backgrounds), self.angles, on_progress=tell)
        write_npy(self.out, np.asarray(heat, np.float32))
        result = {"heat": str(self.out), "seen": int((heat > 0).sum()), "faces": bodies.face_count}
        if self.pick is not None:
            result |= write_logo(logo, bodies, hottest_faces(heat, face_areas(bodies), self.pick))
        return result

    def show(self, result: dict) -> None:
        out.print(f"wrote {result['heat']}: {result['seen']} of {result['faces']} faces move the score")
        if "out" in result:
            show_logo(result)


@dataclass(kw_only=True)
class Transfer(Command):
    """Carry a logo and trained colours onto a body of another topology."""

    example = "--from sample --to scene --logo chest.npy --colors runs/first --out carried.npy"

    source: Annotated[str, tyro.conf.arg(name="from")]
    """Scene that the logo belongs to."""
    target: Annotated[str, tyro.conf.arg(name="to")]
    """Scene to carry it onto."""
    logo: Path
    """Face list on the source (.npy)."""
    out: Path
    """Face list to write; trained colours go beside it, NAME-colors.npy."""
    colors: Path | None = None
    """Run folder (or zoo:NAME) whose colours come along."""

    def run(self) -> dict:
        from cloak_core.core.logo import load_logo
        from cloak_core.exchange.face_lists import read_colors, write_colors
        from cloak_core.products.transfer import transfer_logo
        from cloak_core.zoo.entry import run_path

        painted = self.out.with_name(self.out.stem + "-colors.npy")
        for path in [self.out] + [painted] * (self.colors is not None):
            require_new(path)
        source, target = load_scene(self.source), load_scene(self.target)
        ids = load_logo(source, self.logo).face_ids
        colors = None if self.colors is None else read_colors(run_path(self.colors) / "colors.npy", len(ids))
        moved = transfer_logo(source, ids, target, colors)
        result = write_logo(self.out, target, moved.face_ids)
        if moved.colors is not None:
            write_colors(painted, moved.colors)
            result["colors"] = str(painted)
        return result | {
            "coverage": moved.coverage,
            "largest_distance": moved.largest_distance,
            "unplaced": len(moved.unplaced),
        }

    def show(self, result: dict) -> None:
        show_logo(result)
        out.print(
            f"{result['coverage']:.1%} of the logo's area found a place, at most "
            f"{result['largest_distance'] * 100:.1f} cm away; {result['unplaced']} faces did not"
        )
