"""Logos that experiments compare: the paper's, and shapes of growing area."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Int64
from PIL import Image, ImageDraw

from cloak_core.core.geometry import face_areas, face_centres
from cloak_core.core.logo import area_share, chest_thighs
from cloak_core.core.pictures import save_picture
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.bodies.logos.stamping import project_mask, project_text, sized_stamp

FaceIds = Int64[np.ndarray, " _"]
PAPER_SHARES = {"letter G": 2426 / 55152, "smiley": 2427 / 55152, "chest + thighs": 4691 / 55152}
"""Faces of the paper's logos over faces of its body. Its faces differ in area, so a share of faces is only near one."""


def paper_logos(bodies: Bodies, folder: Path) -> dict[str, FaceIds]:
    """Make the paper's logos at its shares of the area, and whole chest + thighs; `folder` takes the drawn smiley."""
    folder.mkdir(parents=True, exist_ok=True)
    whole = chest_thighs(bodies)
    smiley = draw_smiley(folder / "smiley.png")
    return {
        "letter G": sized_stamp(partial(project_text, bodies, "G"), bodies, PAPER_SHARES["letter G"]),
        "smiley": sized_stamp(partial(project_mask, bodies, smiley), bodies, PAPER_SHARES["smiley"]),
        "chest + thighs, small": trimmed(bodies, whole, PAPER_SHARES["chest + thighs"]),
        "chest + thighs": whole,
    }


def shapes(bodies: Bodies, folder: Path, quick: bool) -> dict[str, FaceIds]:
    """Make shapes on the chest at growing shares of the body's area, up to what the front of the trunk holds."""
    folder.mkdir(parents=True, exist_ok=True)
    disc = Image.new("L", (256, 256), 255)
    ImageDraw.Draw(disc).ellipse((1, 1, 254, 254), fill=0)
    save_picture(folder / "disc.png", disc)
    makers: dict[str, Callable[..., FaceIds]] = {
        "disc": partial(project_mask, bodies, folder / "disc.png"),
        "smiley": partial(project_mask, bodies, draw_smiley(folder / "smiley.png")),
        "letter G": partial(project_text, bodies, "G"),
    }
    fractions = (0.01, PAPER_SHARES["letter G"]) if quick else (0.005, 0.01, 0.02, PAPER_SHARES["letter G"], 0.06)
    logos = {}
    for name in ("disc", "letter G") if quick else tuple(makers):
        for fraction in fractions:
            ids = sized_stamp(makers[name], bodies, fraction)
            # A shape that cannot grow so far would only repeat the one before.
            if abs(area_share(bodies, ids) - fraction) < 0.25 * fraction:
                logos[f"{name} {fraction:.1%}"] = ids
    whole = chest_thighs(bodies)
    return logos | {f"chest + thighs {area_share(bodies, whole):.1%}": whole}


def trimmed(bodies: Bodies, ids: FaceIds, fraction: float) -> FaceIds:
    """Shrink the chest and each thigh to its middle, so that together they keep this share of the body's area."""
    areas, centers = face_areas(bodies)[ids], face_centres(bodies)[ids]
    target = fraction * face_areas(bodies).sum()
    if areas.sum() <= target:
        return ids
    upper = centers[:, 1] > (centers[:, 1].min() + centers[:, 1].max()) / 2
    kept = []
    for part in (upper, ~upper & (centers[:, 0] >= 0), ~upper & (centers[:, 0] < 0)):
        own = np.flatnonzero(part)
        if len(own):
            away = np.linalg.norm(centers[own] - np.average(centers[own], axis=0, weights=areas[own]), axis=1)
            order = own[np.argsort(away, kind="stable")]
            kept.append(order[np.cumsum(areas[order]) <= target * areas[own].sum() / areas.sum()])
    return np.sort(ids[np.concatenate(kept)])


def draw_smiley(path: Path) -> Path:
    """Draw a smiley, black on white: ring, eyes and mouth."""
    side = 512
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
