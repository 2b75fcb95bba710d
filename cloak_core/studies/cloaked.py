"""What is evaluated: a logo in a run's colours, or in others (a row per face, another run, a picture), on bodies."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32, Int64, UInt8
from PIL import Image

from cloak_core.core.cloth import cloth_coordinates
from cloak_core.core.geometry import face_centres, face_normals, sum_by_face
from cloak_core.core.logo import Logo, load_logo
from cloak_core.core.pictures import read_picture
from cloak_core.core.visibility.texture import look_up
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.colors import read_colors
from cloak_core.exchange.profiles import Profile
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.studies.printed_cloth import PrintedCloth, cloth_of_run
from cloak_core.studies.trained_run import kept_back, read_run
from cloak_core.studies.wearing.clothes import is_picture, read_clothes
from cloak_core.zoo.entry import run_path

CLOTH_CELL = 0.01
"""Metres; faces are about as wide, and show no finer pattern."""


@dataclass(frozen=True, eq=False)
class Cloaked:
    """What is evaluated: a logo in its colours on bodies, and the backgrounds they stand before.

    InputError: colours, logo and scene do not fit together, or there is no background.
    """

    colors: Float32[np.ndarray, "L 3"]
    """Of the logo's faces, in their order."""
    logo: Logo
    bodies: Bodies
    backgrounds: Backgrounds
    cloth: PrintedCloth | None = None
    """What the colours are the means of on each face, where they are a cloth's: worn in its own fineness."""

    def __post_init__(self) -> None:
        logo, bodies = self.logo, self.bodies
        if logo.topology != bodies.topology:
            made = f"the logo was made for topology {logo.topology}, this scene has {bodies.topology}"
            raise InputError(f"scene '{bodies.name}': {made}")
        if len(self.colors) != len(logo.face_ids):
            raise InputError(f"colours for {len(self.colors)} faces, but the logo has {len(logo.face_ids)}")
        if not len(self.backgrounds):
            raise InputError("no background to evaluate on")

    def printed(self, profile: Profile) -> Cloaked:
        """Wear the same colours as they come out of this printer and camera."""
        cloth = None if self.cloth is None else self.cloth.printed(profile)
        return replace(self, colors=profile.photographed(profile.to_send(self.colors)), cloth=cloth)

    def in_colors(self, path: Path, cloth: PrintedCloth | None) -> Cloaked:
        """Wear the colours of a file instead, or the cloth that they are of. InputError: another number of faces."""
        return replace(self, colors=read_colors(path, len(self.logo)), cloth=cloth)


def open_cloaked(
    folder: Path,
    config: dict,
    scene: Bodies | str | os.PathLike | None = None,
    backgrounds: Backgrounds | str | os.PathLike | None = None,
    colors: str | os.PathLike | None = None,
) -> tuple[Cloaked, dict | None, str]:
    """Open a run's cloak, the config.json of the training of its colours (None where there is none), and their name.

    folder, config: of the run. scene, backgrounds: as they are, or by name. colors: a picture as cloth
    (`read_clothes`), or see `colors_of`; None: the run's own, whose name is "". InputError: as for `kept_back`,
    `Cloaked`, `read_clothes` and `colors_of`, and a patch.
    """
    bodies = scene if isinstance(scene, Bodies) else load_scene(scene or kept_back("scene", config))
    if not isinstance(backgrounds, Backgrounds):
        backgrounds = load_backgrounds(backgrounds or kept_back("backgrounds", config))
    logo = load_logo(bodies, folder / "logo.npy")
    if colors is None:
        worn = read_colors(folder / "colors.npy", len(logo))
        trained = config
        name = ""
        cloth = cloth_of_run(folder)
    elif is_picture(os.fspath(colors)):
        clothes = read_clothes(os.fspath(colors))
        if clothes.is_patch:
            raise InputError(f"{colors}: a patch is for people in photographs; bodies wear cloth, @tile=METRES")
        worn = cloth_colors(clothes.picture, clothes.metres, bodies, logo.face_ids)
        trained = None
        name = clothes.name
        cloth = PrintedCloth.of(clothes.picture, clothes.metres)
    else:
        worn, trained, name = colors_of(colors, logo, bodies)
        other = run_path(colors)
        cloth = cloth_of_run(other) if other.is_dir() else None
    return Cloaked(worn, logo, bodies, backgrounds, cloth), trained, name


def colors_of(
    named: str | os.PathLike, logo: Logo, bodies: Bodies
) -> tuple[Float32[np.ndarray, "L 3"], dict | None, str]:
    """Read colours for the logo's faces, the config.json of their run (None where there is none), and their name.

    named: a .npy of colours [L, 3], a picture on the UV map, a run folder, or zoo:NAME. InputError: another number of
    faces, no UV map, a run of another logo.
    """
    path = run_path(named)
    if path.is_dir():
        config = read_run(path)
        return read_colors(path / "colors.npy", len(logo)), config, path.name
    if path.suffix.lower() == ".npy":
        return read_colors(path, len(logo)), None, path.stem
    return from_texture(read_picture(path), logo, bodies, path), None, path.stem


def from_texture(picture: np.ndarray, logo: Logo, bodies: Bodies, path: Path) -> Float32[np.ndarray, "L 3"]:
    """Look up a picture [h, w, 3] uint8 at the centre of each of the logo's faces, by the scene's UV map."""
    if bodies.uv is None:
        raise InputError(f"{path}: scene '{bodies.name}' has no UV map to put a picture on")
    corners = bodies.uv[bodies.triangle_uv].astype(np.float64)  # [T, 3, 2]
    # Of a polygon, the mean over its triangles by their area on the map.
    side_a, side_b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.maximum(np.abs(side_a[:, 0] * side_b[:, 1] - side_a[:, 1] * side_b[:, 0]), 1e-12)
    total = sum_by_face(bodies, area)
    centre = sum_by_face(bodies, corners.mean(1) * area[:, None]) / np.maximum(total, 1e-300)[:, None]
    uv = torch.from_numpy(centre[logo.face_ids].T.astype(np.float32))
    return look_up(torch.from_numpy(np.array(picture)), uv).numpy()


def cloth_colors(
    picture: UInt8[np.ndarray, "h w 3"], metres: float, bodies: Bodies, faces: Int64[np.ndarray, " L"]
) -> Float32[np.ndarray, "L 3"]:
    """Look up a picture as cloth that repeats every `metres`, at the centre of each face in the pose for cloth."""
    width = max(4, round(metres / CLOTH_CELL))
    height = max(4, round(width * picture.shape[0] / picture.shape[1]))
    cells = np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.BOX), np.float32) / 255
    bodies = bodies.for_cloth()
    places = cloth_coordinates(face_centres(bodies)[faces], face_normals(bodies)[faces])
    column, row = np.floor(places / metres * width).astype(np.int64).T
    return cells[row % height, column % width]
