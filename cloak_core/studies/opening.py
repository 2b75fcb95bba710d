"""Open what is judged by name: a run's colours, a file of colours, a picture as cloth or on the chest."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float32, UInt8

from cloak_core.core.geometry import sum_by_face
from cloak_core.core.logo import Cover, load_logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.pictures import read_picture
from cloak_core.core.prints import print_picture
from cloak_core.core.technique import call_package
from cloak_core.core.visibility.texture import look_up
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.cloth import CLOTH_FILE, cloth_metres
from cloak_core.exchange.face_lists import read_colors, read_face_list
from cloak_core.exchange.profiles import Profile
from cloak_core.files.errors import InputError
from cloak_core.patterns.chest import ChestPattern
from cloak_core.patterns.cloth import ClothPattern
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.rig import NUMBER, body_rig, faces_on_rig
from cloak_core.studies.trained_run import read_run
from cloak_core.zoo.entry import MARK, run_path

if TYPE_CHECKING:
    from cloak_core.core.training import RunResult

CLOTHES = "shirt+trousers"
"""What a picture covers as cloth, and the controls, where nothing else is said."""
CHEST = 0.40
"""Middle of a picture on the chest: metres above the middle of the hips of the body at rest."""
FLIPPED = "@flipped"
"""Ends the name of a picture that is worn upside down (mirrored top to bottom): the same shapes, lit from below."""
_PICTURE = re.compile(r"(?P<file>.+)@(?P<kind>tile|patch)=(?P<metres>[^@/]*)")
_PRINT, _PACKAGE = "print:", "pattern:"
Opened = tuple[Pattern, dict | None, str]
"""A pattern in its colours, the config.json of the training of these (None where there is none), and its name."""


@lru_cache(maxsize=8)
def clothes_cover(logo: str | None = None) -> Cover:
    """Faces of the sample bodies: regions or a face list, else shirt and trousers. InputError: there are none."""
    return load_logo(sample_bodies(), logo or CLOTHES)


@lru_cache(maxsize=1)
def _chest_cover() -> Cover:
    """The faces of chest and hips that look forward, of the sample bodies."""
    rig, topology = body_rig(), sample_bodies().topology
    forward = np.isin(rig.segment_of_triangle, (NUMBER["chest"], NUMBER["pelvis"])) & (rig.normals[:, 2] > 0.1)
    return Cover(np.unique(faces_on_rig(topology)[forward]), topology, name="chest")


def find_run(run: RunResult | str | os.PathLike) -> tuple[Path, dict]:
    """Find a run, by its folder, as zoo:NAME or as what training returned, and read its record.

    InputError: no finished run.
    """
    folder = run_path(run) if isinstance(run, str | os.PathLike) else Path(run.out)
    return folder, read_run(folder)


def cover_of_run(folder: Path, config: dict, bodies: Bodies | None = None) -> Cover:
    """Read the faces that a run covers. InputError: they are not those of `bodies`, where some are given."""
    name = config.get("cover") or Path(config.get("inputs", {}).get("logo", "logo")).stem
    if bodies is not None:
        return replace(load_logo(bodies, folder / "logo.npy"), name=name)
    return Cover(np.asarray(read_face_list(folder / "logo.npy").ids, np.int64), config["topology"], name=name)


def run_pattern(folder: Path, cover: Cover, bodies: Bodies | None = None) -> Pattern:
    """Read what a run trained, on these faces: its cloth in its own fineness, else colours of faces. InputError."""
    if (folder / CLOTH_FILE).exists():
        return ClothPattern.of_picture(cover, read_picture(folder / CLOTH_FILE), cloth_metres(folder), bodies=bodies)
    return FacePattern(cover, bodies, read_colors(folder / "colors.npy", len(cover)))


def snapshot_pattern(folder: Path, colors: Path, cover: Cover) -> Pattern:
    """Read a run's snapshot: the picture beside its colours, where a cloth was trained.

    InputError: there is no such picture. Faces show less of a cloth than it has, so they say nothing of its success.
    """
    if not (folder / CLOTH_FILE).exists():
        return FacePattern(cover, colors=read_colors(colors, len(cover)))
    picture = colors.with_suffix(".png")
    if not picture.exists():
        message = "no such file: this run's snapshots are of an earlier version, which kept the faces' colours alone"
        raise InputError(f"{picture}: {message}; train again with --snapshot-every")
    return ClothPattern.of_picture(cover, read_picture(picture), cloth_metres(folder))


def open_run(
    folder: Path,
    config: dict,
    colors: str | os.PathLike | None,
    bodies: Bodies | None = None,
    logo: str | os.PathLike | None = None,
) -> Opened:
    """Open a run's own colours (its name is ""), or others on the faces that it covers; see `open_pattern`.

    logo: a face list or regions of `bodies` (else the sample bodies) that wear it instead; they join the name.
    """
    cover = cover_of_run(folder, config, bodies)
    if colors is None:
        pattern, training, name = run_pattern(folder, cover, bodies), config, ""
    else:
        named = os.fspath(colors)
        # A zoo entry is called as its folder is: the name becomes part of a path.
        named = os.fspath(run_path(named)) if named.startswith(MARK) else named
        pattern, training, name = open_pattern(named, cover, bodies)
    if logo is None:
        return pattern, training, name
    chosen = load_logo(bodies or sample_bodies(), logo)
    return pattern.on(chosen), training, "-".join(part for part in (name, chosen.name) if part)


def open_pattern(spec: str, cover: Cover | None = None, bodies: Bodies | None = None) -> Opened:
    """Open a run's folder, zoo:NAME, a file of colours [L, 3], or a picture: PICTURE@tile=METRES, PICTURE@patch=METRES.

    pattern:NAME[:TEXT] is made by another package, whose code runs: only a caller may name it, no file.

    PICTURE: a file, print:NAME (a plain print of ours), or a run or zoo:NAME whose cloth repeats. @flipped after any
    cloth or picture wears it upside down. cover: the faces that wear it; None: a run's own, else shirt and trousers.
    bodies: whose UV map any other picture is put on. InputError: names `spec`.
    """
    if spec.endswith(FLIPPED):
        pattern, _, name = open_pattern(spec.removesuffix(FLIPPED), cover, bodies)
        upright = pattern.picture(pattern.colors)
        if upright is None:
            raise InputError(f"{spec}: has colours of faces; a picture or a cloth can be turned upside down")
        return replace(pattern, colors=upright[::-1].reshape(-1, 3).copy()), None, name + FLIPPED
    if spec.startswith(_PACKAGE):
        named = spec.removeprefix(_PACKAGE)
        pattern, _ = call_package("cloak.patterns", named, Pattern, cover or clothes_cover(), bodies)
        return pattern, None, re.sub(r"[/\\]", "-", spec)
    picture = _PICTURE.fullmatch(spec)
    if picture is not None:
        try:
            metres = float(picture["metres"])
        except ValueError:
            raise InputError(f"{spec}: the width {picture['metres']} is not a number of metres") from None
        if not 0.01 <= metres <= 5:
            raise InputError(f"{spec}: {picture['metres']} metres are not between 0.01 and 5")
        name, pixels = _picture_of(picture["file"])
        name = f"{name}@{picture['kind']}={metres:g}"
        if picture["kind"] == "patch":
            height, width = pixels.shape[:2]
            top = -(body_rig().joints["l_hip"][1] + CHEST) - metres * height / width / 2
            corner = (-metres / 2, float(top))
            return ChestPattern.of_picture(_chest_cover(), pixels, metres, corner=corner), None, name
        return ClothPattern.of_picture(cover or clothes_cover(), pixels, metres, bodies=bodies), None, name
    path = run_path(spec)
    if not path.is_dir() and path.suffix.lower() == ".npy" and cover is not None:
        return FacePattern(cover, bodies, read_colors(path, len(cover))), None, path.stem
    if spec.startswith(_PRINT) or path.is_file():
        if bodies is None or spec.startswith(_PRINT):
            raise InputError(f"{spec}: say how wide it is worn: {spec}@tile=0.5 or {spec}@patch=0.3 (metres)")
        return FacePattern(cover, bodies, from_texture(read_picture(path), cover, bodies, path)), None, path.stem
    config = read_run(path)
    name = spec if spec.startswith("zoo:") else path.name
    return run_pattern(path, cover or cover_of_run(path, config), bodies), config, name


def _picture_of(named: str) -> tuple[str, UInt8[np.ndarray, "h w 3"]]:
    """Read a picture, and what to call it: a file's, a print's, or a run's cloth."""
    if named.startswith(_PRINT):
        return named, print_picture(named.removeprefix(_PRINT))
    if not named.startswith("zoo:") and not Path(named).is_dir():
        return Path(named).stem, read_picture(Path(named))
    cloth = run_path(named) / CLOTH_FILE
    if not cloth.exists():
        raise InputError(f"{named}: has no cloth that repeats ({CLOTH_FILE}), so no width to choose")
    return named if named.startswith("zoo:") else Path(named).name, read_picture(cloth)


def cloth_spec(pattern: str) -> str:
    """Name a pattern's width where it is only FILE.png: 0.25 m, where most hide most (docs/reports/photographs.md)."""
    worn = pattern.startswith(_PACKAGE) or "@tile=" in pattern or "@patch=" in pattern
    return pattern if worn else f"{pattern}@tile=0.25"


def printed(pattern: Pattern, profile: Profile) -> Pattern:
    """Wear a pattern as it comes out of this printer and camera."""
    return pattern.recolored(lambda colors: profile.photographed(profile.to_send(colors)))


def from_texture(
    picture: UInt8[np.ndarray, "h w 3"], cover: Cover, bodies: Bodies, path: Path
) -> Float32[np.ndarray, "L 3"]:
    """Look up a picture at the centre of each face by the scene's UV map. InputError: it has none."""
    if bodies.uv is None:
        raise InputError(f"{path}: scene '{bodies.name}' has no UV map to put a picture on")
    corners = bodies.uv[bodies.triangle_uv].astype(np.float64)  # [T, 3, 2]
    # Of a polygon, the mean over its triangles by their area on the map.
    side_a, side_b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.maximum(np.abs(side_a[:, 0] * side_b[:, 1] - side_a[:, 1] * side_b[:, 0]), 1e-12)
    total = sum_by_face(bodies, area)
    centre = sum_by_face(bodies, corners.mean(1) * area[:, None]) / np.maximum(total, 1e-300)[:, None]
    uv = torch.from_numpy(centre[cover.face_ids].T.astype(np.float32))
    return look_up(torch.from_numpy(np.array(picture)), uv).numpy()
