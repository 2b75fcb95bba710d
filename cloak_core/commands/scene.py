"""`cloak scene ...`: bodies in, scene packages out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from cloak_core.commands.base import Command, open_scene, out, require_new
from cloak_core.scene.exchange import Bodies, write_scene


def describe(bodies: Bodies) -> dict:
    return {
        "poses": bodies.pose_count,
        "vertices": bodies.vertex_count,
        "triangles": bodies.triangle_count,
        "faces": bodies.face_count,
        "topology": bodies.topology,
        "name": bodies.name,
        "outfits": bodies.outfit_count,
        "regions": {name: int(mask.sum()) for name, mask in bodies.regions.items()},
        "names": list(bodies.names),
        "height_m": [round(float(h), 3) for h in (bodies.vertices[..., 1].max(1) - bodies.vertices[..., 1].min(1))],
    }


def show_scene(result: dict) -> None:
    if "out" in result:
        out.print(f"wrote {result['out']}", markup=False)
    for key in ("poses", "vertices", "triangles", "faces", "outfits", "topology"):
        out.print(f"{key:<10} {result[key]}", markup=False)
    if result["regions"]:
        out.print("regions    " + ", ".join(f"{k} ({v})" for k, v in result["regions"].items()), markup=False)


@dataclass(kw_only=True)
class Import(Command):
    """Make a scene from posed meshes (.obj, .glb, .ply, .npz): one topology, one pose per file."""

    files: Positional[tuple[Path, ...]]
    """One mesh file per pose."""
    out: Path
    """Scene folder to write."""
    subdivide: int = 0
    """Levels of midpoint subdivision (1 splits every triangle and quad in four)."""
    scale: float | None = None
    """Metres in one unit of the files, 0.01 for centimetres (default: metres, refused where heights make no sense)."""
    frames: int = 0
    """Take this many moments of a glTF file's first animation as poses."""

    def run(self) -> dict:
        from cloak_core.scene.bodies import import_bodies, subdivide

        require_new(self.out)
        bodies = import_bodies(self.files, self.out.name, scale=self.scale, frames=self.frames)
        if self.subdivide:
            bodies, _ = subdivide(bodies, self.subdivide)
        write_scene(self.out, bodies)
        return {"out": str(self.out), **describe(bodies)}

    show = staticmethod(show_scene)


@dataclass(kw_only=True)
class ImportSmpl(Command):
    """Make a scene from your own SMPL, SMPL+H or SMPL-X model file and a file of poses."""

    model: Path
    """Model file, .npz or the original .pkl (read without running anything in it)."""
    poses: Path
    """Poses: AMASS-like .npz, SURREAL _info.mat, .npy or .csv rows of 72 pose and 10 shape numbers."""
    out: Path
    """Scene folder to write."""
    every: int = 1
    """Take each n-th pose."""
    limit: int | None = None
    """At most so many poses."""
    subdivide: int = 0
    """Levels of midpoint subdivision."""

    def run(self) -> dict:
        from cloak_core.scene.bodies import subdivide
        from cloak_core.scene.smpl import import_smpl

        require_new(self.out)
        bodies = import_smpl(self.model, self.poses, self.out.name, every=self.every, limit=self.limit)
        if self.subdivide:
            bodies, _ = subdivide(bodies, self.subdivide)
        write_scene(self.out, bodies)
        return {"out": str(self.out), **describe(bodies)}

    show = staticmethod(show_scene)


@dataclass(kw_only=True)
class Sample(Command):
    """Write the embedded sample bodies as a scene."""

    out: Path
    """Scene folder to write."""
    split: Literal["all", "train", "unseen"] = "all"
    """All bodies, those for training, or those kept back for evaluation."""

    def run(self) -> dict:
        from cloak_core.scene.samples import sample_bodies

        require_new(self.out)
        bodies = sample_bodies(self.split)
        write_scene(self.out, bodies)
        return {"out": str(self.out), **describe(bodies)}

    show = staticmethod(show_scene)


@dataclass(kw_only=True)
class Info(Command):
    """Say what a scene holds."""

    scene: Positional[str]
    """Scene folder, .npz, or sample[:train|unseen]."""
    distance: float = 2.2
    """Camera distance, in metres, at which the projected face areas are told."""

    def run(self) -> dict:
        from dataclasses import asdict

        from cloak_core.scene.cameras import Camera
        from cloak_core.scene.resolution import resolution

        bodies = open_scene(self.scene)
        return describe(bodies) | {"resolution": asdict(resolution(bodies, Camera(distance=self.distance)))}

    def show(self, result: dict) -> None:
        show_scene(result)
        out.print(f"resolution {result['resolution']['hint']}", markup=False)
