"""`cloak scene ...`: bodies in, scene packages out."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional, UseAppendAction

from cloak_core.commands.base import Command, out, warn
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import write_scene
from cloak_core.files.writing import require_new
from cloak_core.sources.bodies.opening import load_scene


def describe(bodies: Bodies) -> dict:
    return {
        "poses": bodies.pose_count,
        "vertices": bodies.vertex_count,
        "triangles": bodies.triangle_count,
        "faces": bodies.face_count,
        "topology": bodies.topology,
        "name": bodies.name,
        "outfits": bodies.outfit_count,
        "textures": [name for name in bodies.outfit_textures if name],
        "regions": {name: int(mask.sum()) for name, mask in bodies.regions.items()},
        "names": list(bodies.names),
        "height_m": [round(float(h), 3) for h in (bodies.vertices[..., 1].max(1) - bodies.vertices[..., 1].min(1))],
    }


def show_scene(result: dict) -> None:
    if "out" in result:
        out.print(f"wrote {result['out']}")
    for key in ("poses", "vertices", "triangles", "faces", "outfits", "topology"):
        out.print(f"{key:<10} {result[key]}")
    if result["textures"]:
        out.print("textures   " + ", ".join(result["textures"]))
    if result["regions"]:
        out.print("regions    " + ", ".join(f"{k} ({v})" for k, v in result["regions"].items()))


@dataclass(kw_only=True)
class Writes(Command):
    """A command that makes bodies and writes them as a scene."""

    out: Path
    """Scene folder to write."""

    def bodies(self) -> Bodies:
        raise NotImplementedError

    def run(self) -> dict:
        require_new(self.out)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            bodies = self.bodies()
        for message in dict.fromkeys(str(warning.message) for warning in caught):
            warn(message)
        write_scene(self.out, bodies)
        return {"out": str(self.out), **describe(bodies)}

    show = staticmethod(show_scene)


@dataclass(kw_only=True)
class Imports(Writes):
    """A command that reads bodies, and may give them a finer mesh, another UV map and textures."""

    subdivide: int = 0
    """Levels of midpoint subdivision; 1 splits every triangle and quad in four."""
    texture: UseAppendAction[tuple[Path, ...]] = ()
    """Picture on the UV map, or folder of pictures: one outfit each, instead of the file's own."""
    uv: Path | None = None
    """UV map from an .obj of the same mesh, or .npz with vt and ft."""

    def read(self) -> Bodies:
        raise NotImplementedError

    def bodies(self) -> Bodies:
        from cloak_core.sources.bodies.meshes.subdivision import subdivide
        from cloak_core.sources.bodies.meshes.textures import dress_in_textures, read_textures, with_uv_of

        bodies = self.read()
        if self.uv is not None:
            bodies = with_uv_of(bodies, self.uv)
        if self.texture:
            bodies = dress_in_textures(bodies, read_textures(self.texture))
        return subdivide(bodies, self.subdivide)[0]


@dataclass(kw_only=True)
class Import(Imports):
    """Make a scene of posed or animated meshes of one topology: .obj, .glb, .ply, .npz; with Blender .abc and .usd."""

    example = "pose1.obj pose2.obj --out scene"

    files: Positional[tuple[Path, ...]]
    """One mesh file per pose, or animated files."""
    scale: float | None = None
    """Metres in one unit of the files, 0.01 for centimetres (default: metres, if heights make sense)."""
    frames: int = 0
    """Moments of each animated file to take as poses; 0: the resting pose."""

    def read(self) -> Bodies:
        from cloak_core.sources.bodies.meshes.importing import import_bodies

        return import_bodies(self.files, self.out.name, scale=self.scale, frames=self.frames)


@dataclass(kw_only=True)
class ImportSmpl(Imports):
    """Make a scene of your own SMPL, SMPL+H or SMPL-X model and poses."""

    example = "--model SMPL_NEUTRAL.npz --poses walk.npz --every 10 --out scene"

    model: Path
    """Model: .npz, or the original .pkl (nothing in it is run)."""
    poses: Path
    """AMASS-like .npz, SURREAL _info.mat, or .npy or .csv rows of 72 pose and 10 shape numbers."""
    every: int = 1
    """Take each n-th pose."""
    limit: int | None = None
    """Most poses to take."""

    def read(self) -> Bodies:
        from cloak_core.sources.bodies.people.smpl import import_smpl

        return import_smpl(self.model, self.poses, self.out.name, every=self.every, limit=self.limit)


@dataclass(kw_only=True)
class ImportAnny(Imports):
    """Draw random adult bodies and poses from Anny (extra `anny`), with the sample bodies' mesh."""

    example = "--count 64 --seed 1 --out scene"

    count: int = 64
    """Bodies to draw; one for each training image shows none twice."""
    seed: int = 0
    poses: str = "natural"
    """natural (all in turn), stand, walk, run or wave; or a file of Anny's pose_parameters [P, 104, 4, 4] (.npy,
    .npz)."""

    def read(self) -> Bodies:
        from cloak_core.sources.bodies.people.anny import anny_bodies

        return anny_bodies(self.count, self.seed, self.poses, self.out.name)


@dataclass(kw_only=True)
class Sample(Writes):
    """Write the embedded sample bodies as a scene."""

    example = "--split train --out scene"

    split: Literal["all", "train", "unseen"] = "all"
    """All bodies, those for training, or those kept back."""
    clothed: bool = False
    """Bodies in motion, in loose clothes (sample-clothed)."""

    def bodies(self) -> Bodies:
        from cloak_core.sources.bodies.people.clothed import clothed_bodies
        from cloak_core.sources.bodies.people.samples import sample_bodies

        return clothed_bodies(self.split) if self.clothed else sample_bodies(self.split)


@dataclass(kw_only=True)
class Info(Command):
    """Say what a scene holds."""

    example = "sample"

    scene: Positional[str]
    distance: float = 2.2
    """Camera distance for the sizes of faces, metres."""

    def run(self) -> dict:
        from cloak_core.core.cameras import Camera
        from cloak_core.sources.bodies.meshes.subdivision import resolution

        bodies = load_scene(self.scene)
        return describe(bodies) | {"resolution": resolution(bodies, Camera(distance=self.distance))}

    def show(self, result: dict) -> None:
        show_scene(result)
        out.print(f"resolution {result['resolution']['hint']}")
