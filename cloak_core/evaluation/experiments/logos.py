"""The logos that experiments compare, by name, each with its share of the body's area."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Int64
from PIL import Image, ImageDraw

from cloak_core.exchange.bodies import Bodies
from cloak_core.files.errors import InputError
from cloak_core.scene.geometry import face_areas, face_centres
from cloak_core.scene.logos.logo import area_share, select_region
from cloak_core.scene.logos.stamping import project_mask, project_text
from cloak_core.scene.pictures import save_picture

FaceIds = Int64[np.ndarray, "_"]
PAPER_SHARES = {"letter G": 2426 / 55152, "smiley": 2427 / 55152, "chest + thighs": 4691 / 55152}
"""Faces of the paper's logos over faces of its body. Its faces differ in area, so a share of faces is only near one."""


def paper_logos(bodies: Bodies, folder: Path) -> dict[str, FaceIds]:
    """The paper's three logos at its shares of the body, and chest + thighs whole. `folder` takes the drawn smiley."""
    folder.mkdir(parents=True, exist_ok=True)
    whole = chest_thighs(bodies)
    smiley = draw_smiley(folder / "smiley.png")
    return {
        "letter G": with_share(partial(project_text, bodies, "G"), bodies, PAPER_SHARES["letter G"]),
        "smiley": with_share(partial(project_mask, bodies, smiley), bodies, PAPER_SHARES["smiley"]),
        "chest + thighs, small": trimmed(bodies, whole, PAPER_SHARES["chest + thighs"]),
        "chest + thighs": whole,
    }


def chest_thighs(bodies: Bodies) -> FaceIds:
    """The front of chest and thighs, under the name the scene has for it."""
    if "chest_thighs" in bodies.regions and not {"chest", "thighs"} <= bodies.regions.keys():
        return np.flatnonzero(bodies.regions["chest_thighs"]).astype(np.int64)
    return select_region(bodies, "chest+thighs")


def shirt_trousers(bodies: Bodies) -> FaceIds:
    """Shirt and trousers all around, for attacks from every side."""
    if "shirt_trousers" in bodies.regions:
        return np.flatnonzero(bodies.regions["shirt_trousers"]).astype(np.int64)
    return select_region(bodies, "shirt-all+trousers-all")


def shapes(bodies: Bodies, folder: Path, quick: bool) -> dict[str, FaceIds]:
    """A family of shapes on the chest at growing shares of the body's area, up to what the front of the trunk holds."""
    folder.mkdir(parents=True, exist_ok=True)
    makers: dict[str, Callable[..., FaceIds]] = {
        "disc": partial(project_mask, bodies, draw_disc(folder / "disc.png")),
        "smiley": partial(project_mask, bodies, draw_smiley(folder / "smiley.png")),
        "letter G": partial(project_text, bodies, "G"),
    }
    kept = ("disc", "letter G") if quick else tuple(makers)
    shares = (0.01, PAPER_SHARES["letter G"]) if quick else (0.005, 0.01, 0.02, PAPER_SHARES["letter G"], 0.06)
    logos = {}
    for name in kept:
        for share in shares:
            ids = with_share(makers[name], bodies, share)
            # A shape that cannot grow so far would only repeat the one before.
            if abs(area_share(bodies, ids) - share) < 0.25 * share:
                logos[f"{name} {share:.1%}"] = ids
    whole = chest_thighs(bodies)
    logos |= {f"chest + thighs {area_share(bodies, whole):.1%}": whole}
    return logos


def with_share(make: Callable[..., FaceIds], bodies: Bodies, share: float) -> FaceIds:
    """The stamp whose height (metres, by bisection up to 1 m) gives it this share of the body's area, or near it."""
    low, high = 0.0, 1.0
    best, distance = None, np.inf
    for _ in range(14):
        height = (low + high) / 2
        try:
            ids = make(height=height)
            found = area_share(bodies, ids)
        except InputError:  # too small to cover the centre of any face
            ids, found = None, 0.0
        if ids is not None and abs(found - share) < distance:
            best, distance = ids, abs(found - share)
        low, high = (height, high) if found < share else (low, height)
    if best is None:
        raise InputError(f"scene '{bodies.name}': no stamp of {share:.1%} of its area fits on the chest")
    return best


def trimmed(bodies: Bodies, ids: FaceIds, share: float) -> FaceIds:
    """The part of chest + thighs that keeps this share of the body's area: each of the three shrinks to its middle."""
    areas, centers = face_areas(bodies)[ids], face_centres(bodies)[ids]
    target = share * face_areas(bodies).sum()
    if areas.sum() <= target:
        return ids
    upper = centers[:, 1] > (centers[:, 1].min() + centers[:, 1].max()) / 2
    parts = [upper, ~upper & (centers[:, 0] >= 0), ~upper & (centers[:, 0] < 0)]
    kept = []
    for part in parts:
        own = np.flatnonzero(part)
        if len(own):
            spread = np.linalg.norm(centers[own] - np.average(centers[own], axis=0, weights=areas[own]), axis=1)
            order = own[np.argsort(spread, kind="stable")]
            room = target * areas[own].sum() / areas.sum()
            kept.append(order[np.cumsum(areas[order]) <= room])
    return np.sort(ids[np.concatenate(kept)])


def draw_smiley(path: Path, side: int = 512) -> Path:
    """A smiley: ring, eyes and mouth, black on white."""
    image = Image.new("L", (side, side), 255)
    draw = ImageDraw.Draw(image)
    unit = side / 16
    draw.ellipse((0.3 * unit, 0.3 * unit, 15.7 * unit, 15.7 * unit), fill=0)
    draw.ellipse((2.1 * unit, 2.1 * unit, 13.9 * unit, 13.9 * unit), fill=255)
    for x in (5.6, 10.4):
        draw.ellipse(((x - 1.2) * unit, 4.4 * unit, (x + 1.2) * unit, 7.2 * unit), fill=0)
    draw.arc((4 * unit, 4.2 * unit, 12 * unit, 12.2 * unit), 20, 160, fill=0, width=round(1.7 * unit))
    save_picture(path, image)
    return path


def draw_disc(path: Path, side: int = 256) -> Path:
    """A disc, black on white."""
    image = Image.new("L", (side, side), 255)
    ImageDraw.Draw(image).ellipse((1, 1, side - 2, side - 2), fill=0)
    save_picture(path, image)
    return path
