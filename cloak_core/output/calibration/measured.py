"""Patches measured one by one (CSV), and printers that bring a profile of their own (ICC)."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from jaxtyping import Float

from cloak_core.exchange.profiles import Profile
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.reading import read_bytes, read_text
from cloak_core.scene.color_difference import TO_XYZ, mean_difference
from cloak_core.scene.meshes.mesh_file import to_srgb

MAX_BYTES = 4 << 20
SENT, SEEN, LAB = ("sent_r", "sent_g", "sent_b"), ("seen_r", "seen_g", "seen_b"), ("L", "a", "b")
D50 = np.array([0.96422, 1.0, 0.82521])
FROM_D50 = np.array([
    [0.9555766, -0.0230393, 0.0631636], [-0.0282895, 1.0099416, 0.0210077], [0.0122982, -0.0204830, 1.3299098],
])  # fmt: skip
"""Bradford's adaptation of XYZ to D65."""
ICC_STEPS = 17


def read_patches(path: Path) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Read colours sent and seen, sRGB in [0, 1], from a CSV. InputError names the line.

    Its columns are sent_r, sent_g, sent_b (0 to 255) and either seen_r, seen_g, seen_b (0 to 255) or L, a, b (CIELAB
    under D50, as instruments give it). Lines without a measured value are left out.
    """
    reader = csv.DictReader(io.StringIO(read_text(path, MAX_BYTES)))
    names = [name.strip() for name in reader.fieldnames or ()]
    reader.fieldnames = names
    measured = SEEN if set(SEEN) <= set(names) else LAB
    if not set(SENT + measured) <= set(names):
        raise InputError(f"{path}: needs the columns {', '.join(SENT)} and {', '.join(SEEN)} (or {', '.join(LAB)})")
    sent, seen = [], []
    for row in reader:
        if not any((row[name] or "").strip() for name in measured):
            continue
        try:
            sent.append([_number(row[name], 0.0, 255.0) for name in SENT])
            seen.append(
                [_number(row[name], *((0.0, 255.0) if measured is SEEN else (-200.0, 200.0))) for name in measured]
            )
        except ValueError as error:
            raise InputError(f"{path}:{reader.line_num}: {first_line(error)}") from None
    sent, seen = np.array(sent).reshape(-1, 3) / 255, np.array(seen, np.float64).reshape(-1, 3)
    return sent, seen / 255 if measured is SEEN else from_lab(seen)


def _number(text: str | None, low: float, high: float) -> float:
    value = float(text) if text and text.strip() else np.nan
    if not low <= value <= high:
        raise ValueError(f"{text!r} is no number from {low:g} to {high:g}")
    return value


def from_lab(values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Convert CIELAB under D50 to sRGB in [0, 1]; what sRGB cannot show is cut off."""
    y = (values[:, 0] + 16) / 116
    bent = np.stack([y + values[:, 1] / 500, y, y - values[:, 2] / 200], axis=1)
    relative = np.where(bent > 6 / 29, bent**3, 3 * (6 / 29) ** 2 * (bent - 4 / 29))
    linear = relative * D50 @ FROM_D50.T @ np.linalg.inv(TO_XYZ).T
    return to_srgb(linear.clip(0, 1))


def read_icc(path: Path) -> Profile:
    """Read what an ICC profile of a printer says of it, for a sheet that is sent in sRGB.

    A profile for red, green and blue: these numbers go to the printer as they are. One for four inks: they are turned
    into inks first (relative colorimetric both ways, as for paper that the camera takes for white).
    """
    from PIL import Image, ImageCms

    steps = np.linspace(0, 255, ICC_STEPS).round().astype(np.uint8)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(1, -1, 3)
    picture = Image.fromarray(grid)
    try:
        printer = ImageCms.ImageCmsProfile(io.BytesIO(read_bytes(path, MAX_BYTES)))
        space = printer.profile.xcolor_space.strip()
        srgb, intent = ImageCms.createProfile("sRGB"), ImageCms.Intent.RELATIVE_COLORIMETRIC
        if space == "CMYK":
            there = ImageCms.buildTransform(srgb, printer, "RGB", "CMYK", intent)
            picture = ImageCms.applyTransform(picture, there)
        elif space != "RGB":
            raise InputError(f"{path}: an ICC profile for {space}, and not for RGB or CMYK")
        back = ImageCms.buildTransform(printer, srgb, picture.mode, "RGB", intent)
        seen = np.asarray(ImageCms.applyTransform(picture, back), np.float32)[0] / 255
    except (OSError, ImageCms.PyCMSError) as error:
        raise InputError(f"{path}: not a usable ICC profile ({first_line(error)})") from None
    table = seen.reshape(ICC_STEPS, ICC_STEPS, ICC_STEPS, 3)
    before = mean_difference(grid[0] / 255, seen)
    return Profile(table, {"de2000_before": before, "de2000_after": 0.0, "patches": float(len(seen))})
