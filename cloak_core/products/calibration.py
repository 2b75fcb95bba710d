"""From patches sent and seen to a profile: a table that is smooth where nothing was measured, and its file.

Patches come from photographs or a CSV; a printer may bring an ICC profile instead.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve

from cloak_core.exchange.profiles import Profile, write_profile
from cloak_core.files.errors import InputError, first_line
from cloak_core.files.reading import read_bytes, read_text
from cloak_core.products.chart import patch_colors, read_photograph
from cloak_core.sources.bodies.logos.palette import TO_XYZ, mean_difference
from cloak_core.sources.bodies.meshes.mesh_file import to_srgb

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
    sent = np.array(sent).reshape(-1, 3) / 255
    seen = np.array(seen, np.float64).reshape(-1, 3)
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
        srgb = ImageCms.createProfile("sRGB")
        intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
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


STEPS = 9
"""Of the table, along each channel."""
LEAST = 24
"""Patches a fit needs."""
WEIGHTS = (1e-4, 1e-3, 1e-2, 1e-1)
"""Of smoothness, tried in turn."""
FOLDS = 5


def fit_profile(sent: Float[np.ndarray, "n 3"], seen: Float[np.ndarray, "n 3"]) -> Profile:
    """Fit the profile that these patches, sRGB in [0, 1], were seen through.

    A table of STEPS^3 colours whose trilinear values come near to what was seen and whose second differences are small
    (least squares). How much smoothness counts is chosen by patches left out in turn, and their mean CIEDE2000 is the
    profile's error. InputError: too few patches, or all of nearly one colour.
    """
    if len(sent) < LEAST:
        raise InputError(f"{len(sent)} patches were measured, and a profile takes at least {LEAST}")
    if np.linalg.matrix_rank(sent - sent.mean(axis=0), tol=0.1) < 3:
        raise InputError("the patches that were measured do not differ in red, green and blue")
    weights = interpolation(sent)
    bends = _bends()
    fold = np.random.default_rng(0).permutation(len(sent)) % FOLDS
    errors = {}
    for smooth in WEIGHTS:
        left_out = np.empty_like(seen, np.float64)
        for k in range(FOLDS):
            table = _solved(weights[fold != k], seen[fold != k], bends, smooth)
            left_out[fold == k] = weights[fold == k] @ table
        errors[smooth] = mean_difference(left_out.clip(0, 1), seen)
    best = min(errors, key=errors.get)
    table = _solved(weights, seen, bends, best).clip(0, 1).reshape(STEPS, STEPS, STEPS, 3)
    figures = {"de2000_before": mean_difference(sent, seen), "de2000_after": errors[best], "patches": float(len(sent))}
    return Profile(table.astype(np.float32), figures)


def interpolation(sent: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n entries"]:
    """Compute how much each of the table's entries counts for each colour, as `Profile` interpolates."""
    steps = sent.clip(0, 1)[..., None] * (STEPS - 1) - np.arange(STEPS)
    red, green, blue = (1 - np.abs(steps)).clip(0).transpose(1, 0, 2)
    return np.einsum("ni,nj,nk->nijk", red, green, blue).reshape(len(sent), -1)


def _bends() -> Float[np.ndarray, "entries entries"]:
    """Build the quadratic form of the table's second differences along each channel."""
    second = np.diff(np.eye(STEPS), n=2, axis=0)
    form, identity = second.T @ second, np.eye(STEPS)
    channels = [[form if channel == own else identity for channel in range(3)] for own in range(3)]
    return sum(np.kron(np.kron(red, green), blue) for red, green, blue in channels)


def _solved(weights: np.ndarray, seen: np.ndarray, bends: np.ndarray, smooth: float) -> Float[np.ndarray, "entries 3"]:
    # What is linear in the channels, and products of them, bends nothing: the least weight keeps the system regular
    # where few patches were measured.
    system = weights.T @ weights + smooth * bends
    system[np.diag_indices_from(system)] += 1e-9
    return solve(system, weights.T @ seen, assume_a="pos")


def profile_of(measured: Sequence[Path], out: Path) -> Profile:
    """Make the profile of photographs and CSVs of patches (all together), or of one ICC profile; write it to `out`.

    `figures` say what it is worth: mean CIEDE2000 between what was sent and seen, and between what the profile
    foretells and was seen of patches that its fit was not shown (none are needed for ICC: 0).
    """
    if out.suffix != ".npz":
        raise InputError(f"--out {out}: a profile is a .npz")
    printers = [path for path in measured if path.suffix.lower() in (".icc", ".icm")]
    if printers and len(measured) > 1:
        raise InputError(f"--measured {printers[0]}: an ICC profile stands alone")
    if printers:
        profile = read_icc(printers[0])
    else:
        tables = [read_patches(path) for path in measured if path.suffix.lower() == ".csv"]
        photographs = [read_photograph(path) for path in measured if path.suffix.lower() != ".csv"]
        if photographs:
            tables.append((patch_colors(), np.mean(photographs, axis=0)))
        profile = fit_profile(*(np.concatenate(column) for column in zip(*tables, strict=True)))
    write_profile(out, profile)
    return profile
