"""What people in photographs can be dressed in: a run's colours, a picture as cloth, a patch, and the controls."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy import sparse

from cloak_core.core.evaluation.controls import CLOTHING
from cloak_core.core.linear import SparseMap
from cloak_core.core.logo import select_region
from cloak_core.core.pictures import read_picture
from cloak_core.core.prints import print_picture
from cloak_core.core.visibility.texture import look_up
from cloak_core.exchange.cloth import CLOTH_FILE, cloth_metres
from cloak_core.exchange.colors import read_colors
from cloak_core.exchange.face_lists import read_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays, sha256_record
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs.fitting import Fit
from cloak_core.sources.photographs.rig import NUMBER, body_rig
from cloak_core.sources.photographs.views import cloth_places, logo_positions, shares_of
from cloak_core.studies.printed_cloth import PrintedCloth
from cloak_core.studies.trained_run import read_run
from cloak_core.zoo.entry import run_path

CLOTHES = "shirt+trousers"
"""What a cloth covers, and the controls."""
_PICTURE = re.compile(r"(?P<file>.+)@(?P<kind>tile|patch)=(?P<metres>[^@/]*)")
FLIPPED = "@flipped"
"""Ends the name of a picture that is worn upside down (mirrored top to bottom): the same shapes, lit from below."""
_PRINT = "print:"
CHEST = 0.40
"""Middle of a patch: metres above the middle of the hips of the body at rest."""


@runtime_checkable
class Clothes(Protocol):
    """Something to wear: for a fitted person, faces (or pixels) that she shows and their colours."""

    name: str

    def on(self, fit: Fit, number: int) -> tuple[SparseMap, Float[np.ndarray, "L 3"]]:
        """Shares [P, L] of the fit's pixels, and colours [L, 3]. number: the person's, for what is drawn at random."""
        ...


@dataclass(frozen=True, eq=False)
class LogoClothes:
    """Colours of a logo's faces."""

    name: str
    position: np.ndarray
    """Of the rig's triangles among the logo's faces; -1 elsewhere."""
    colors: Float[np.ndarray, "L 3"]

    def on(self, fit: Fit, number: int) -> tuple[SparseMap, Float[np.ndarray, "L 3"]]:
        """See `Clothes`."""
        return shares_of(fit, self.position, len(self.colors)), self.colors


@dataclass(frozen=True, eq=False)
class RandomClothes:
    """Random colours of a logo's faces, others for each person."""

    name: str
    position: np.ndarray
    count: int

    def on(self, fit: Fit, number: int) -> tuple[SparseMap, Float[np.ndarray, "L 3"]]:
        """See `Clothes`."""
        colors = np.random.default_rng([0, number]).random((self.count, 3), np.float32)
        return shares_of(fit, self.position, self.count), colors


@dataclass(frozen=True, eq=False)
class OwnClothes:
    """The person's own clothes, brought onto the faces and back: what laying faces alone does to a detector."""

    name: str
    position: np.ndarray
    count: int

    def on(self, fit: Fit, number: int) -> tuple[SparseMap, Float[np.ndarray, "L 3"]]:
        """See `Clothes`."""
        worn = shares_of(fit, self.position, self.count)
        shares = worn.to_scipy()
        light = fit.shading[:, None] * fit.tint
        seen = fit.person.image.reshape(-1, 3)[fit.pixels] / 255 / light
        total = np.maximum(np.asarray(shares.sum(axis=0)).ravel(), 1e-9)
        return worn, np.clip((shares.T @ seen) / total[:, None], 0, 1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class PictureClothes:
    """A picture: cloth that repeats all over the clothes, or a patch on the chest."""

    name: str
    picture: UInt8[np.ndarray, "h w 3"]
    metres: float
    """Width of the picture on the body."""
    is_patch: bool
    position: np.ndarray
    """Of the rig's triangles among the faces that may wear it; -1 elsewhere."""

    def on(self, fit: Fit, number: int) -> tuple[SparseMap, Float[np.ndarray, "L 3"]]:
        """See `Clothes`."""
        u, v, worn = self._places(fit)
        texture = self._at_scale(fit.scale)
        tall = self.metres * texture.shape[0] / texture.shape[1]
        places = torch.from_numpy(np.stack([u / self.metres, -v / tall]).astype(np.float32))
        return SparseMap.from_scipy(sparse.diags(worn.astype(np.float64))), look_up(
            torch.from_numpy(texture), places
        ).numpy()

    def _places(self, fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Metres right and down on the cloth for each pixel, and whether the pixel wears it."""
        u, v = cloth_places(fit).T
        if not self.is_patch:
            return u, v, self.position[fit.main] >= 0
        rig = body_rig()
        height, width = self.picture.shape[:2]
        tall = self.metres * height / width
        top = -(rig.joints["l_hip"][1] + CHEST) - tall / 2
        u, v = u + self.metres / 2, v - top
        segment, forward = rig.segment_of_triangle()[fit.main], rig.normals[fit.main, 2]
        on_chest = np.isin(segment, (NUMBER["chest"], NUMBER["pelvis"])) & (forward > 0.1)
        return u, v, on_chest & (u >= 0) & (u < self.metres) & (v >= 0) & (v < tall)

    def _at_scale(self, scale: float) -> UInt8[np.ndarray, "h w 3"]:
        """The picture with pixels no smaller than the photograph's, so that it does not alias."""
        from PIL import Image

        height, width = self.picture.shape[:2]
        wanted = max(4, round(self.metres * scale * 1.5))
        picture = Image.fromarray(self.picture)
        if wanted < width:
            picture = picture.resize((wanted, max(4, round(wanted * height / width))), Image.Resampling.BOX)
        return np.array(picture)


def clothes_of(
    name: str, position: np.ndarray, colors: Float[np.ndarray, "L 3"], cloth: PrintedCloth | None
) -> Clothes:
    """Make what a training's colours are worn as: a cloth in its own fineness, else the logo's faces."""
    if cloth is None:
        return LogoClothes(name, position, colors)
    picture = np.round(255 * cloth.colors).astype(np.uint8).reshape(cloth.cloth.rows, cloth.cloth.count, 3)
    return PictureClothes(name, picture, cloth.cloth.metres, False, position)


def content_of(clothes: Clothes) -> str:
    """SHA-256 (hex) of all that decides how clothes look: every field but their name."""
    values = {field.name: getattr(clothes, field.name) for field in fields(clothes) if field.name != "name"}
    arrays = {name: sha256_arrays(value) for name, value in values.items() if isinstance(value, np.ndarray)}
    return sha256_record({"kind": type(clothes).__name__} | values | arrays)


@lru_cache(maxsize=1)
def clothes_position() -> np.ndarray:
    """Shirt and trousers of the sample bodies as a logo: positions of the rig's triangles."""
    bodies = sample_bodies()
    return logo_positions(bodies.topology, select_region(bodies, CLOTHES))


CONTROLS = ("grey", "random", "resampled")


def controls() -> list[Clothes]:
    """The photograph as it is; and all over the clothes grey, random colours, and the own clothes resampled alike."""
    position = clothes_position()
    count = int(position.max()) + 1
    photograph = LogoClothes(CLOTHING, np.full_like(position, -1), np.zeros((1, 3), np.float32))  # no face anywhere
    grey = LogoClothes("grey", position, np.full((count, 3), 0.5, np.float32))
    return [photograph, grey, RandomClothes("random", position, count), OwnClothes("resampled", position, count)]


def cloth_spec(pattern: str) -> str:
    """Name a pattern's width where it is only FILE.png: 0.25 m, where most hide most (docs/reports/photographs.md)."""
    return pattern if "@tile=" in pattern or "@patch=" in pattern else f"{pattern}@tile=0.25"


def is_picture(spec: str) -> bool:
    """Tell whether one of COLORS names a picture, or a cloth worn otherwise than it was trained."""
    return _PICTURE.fullmatch(spec) is not None or spec.startswith(_PRINT) or spec.endswith(FLIPPED)


def read_clothes(spec: str) -> Clothes:
    """Read one of COLORS: a run's folder, zoo:NAME, or a picture, PICTURE@tile=METRES or PICTURE@patch=METRES.

    PICTURE: a file, print:NAME (a plain print of ours), or a run or zoo:NAME whose cloth repeats. @flipped after any
    cloth or picture wears it upside down. InputError: names `spec`.
    """
    if spec.endswith(FLIPPED):
        clothes = read_clothes(spec.removesuffix(FLIPPED))
        if not isinstance(clothes, PictureClothes):
            raise InputError(f"{spec}: has colours of faces; a picture or a cloth can be turned upside down")
        return replace(clothes, name=clothes.name + FLIPPED, picture=clothes.picture[::-1].copy())
    picture = _PICTURE.fullmatch(spec)
    if picture is not None:
        try:
            metres = float(picture["metres"])
        except ValueError:
            raise InputError(f"{spec}: the width {picture['metres']} is not a number of metres") from None
        if not 0.01 <= metres <= 5:
            raise InputError(f"{spec}: {picture['metres']} metres are not between 0.01 and 5")
        name, pixels = _picture_of(picture["file"])
        is_patch = picture["kind"] == "patch"
        return PictureClothes(f"{name}@{picture['kind']}={metres:g}", pixels, metres, is_patch, clothes_position())
    if spec.startswith(_PRINT) or (not spec.startswith("zoo:") and Path(spec).is_file()):
        raise InputError(f"{spec}: say how wide it is worn: {spec}@tile=0.5 or {spec}@patch=0.3 (metres)")
    folder = run_path(spec)
    config = read_run(folder)
    faces = read_face_list(folder / "logo.npy")
    name = spec if spec.startswith("zoo:") else folder.name
    position = logo_positions(config["topology"], np.asarray(faces.ids, np.int64))
    if (folder / CLOTH_FILE).exists():
        # Printed as one piece: finer than the faces that it is shown on elsewhere.
        return PictureClothes(name, read_picture(folder / CLOTH_FILE), cloth_metres(folder), False, position)
    return LogoClothes(name, position, read_colors(folder / "colors.npy", len(faces.ids)))


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
