"""The chart of `cloak calibrate`: patches of known colours between four marks, on one sheet of A4."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from cloak_core.core.pictures import open_picture, perspective
from cloak_core.files.errors import InputError
from cloak_core.files.writing import replace_file, write_text
from cloak_core.products.print_sheets import draw_foot
from cloak_core.products.tiling import PAGES
from cloak_core.sources.bodies.meshes.mesh_file import to_linear, to_srgb

COLUMNS, ROWS = 16, 22
LEVELS = 7
"""Of each channel: 343 patches; greys fill the sheet."""
LOW, HIGH = (0.015, 0.049), (0.195, 0.271)
"""Metres: the corners of the field of patches, from the sheet's lower left one."""
FILLED = 0.8
"""Share of its cell's width and height that a patch fills; the rest is paper, by which uneven light is seen."""
MARK = 0.014
MARKS = np.array([[0.022, 0.038], [0.188, 0.038], [0.188, 0.282], [0.022, 0.282]])
"""Centres of the marks, metres, counter-clockwise: black squares with a white ring, 3 : 5 : 7 as in QR codes."""


def patch_colors() -> Float[np.ndarray, "352 3"]:
    """List the patches' colours as they are sent, sRGB in [0, 1], row by row from the upper left one.

    In mixed order, so that light that falls off over the sheet looks like no colour.
    """
    steps = np.linspace(0, 1, LEVELS)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    greys = np.linspace(0, 1, COLUMNS * ROWS - len(grid) + 2)[1:-1, None].repeat(3, axis=1)
    colors = np.concatenate([grid, greys])
    colors = colors[np.random.default_rng(2000).permutation(len(colors))]
    return np.round(colors * 255) / 255


def patch_centres() -> Float[np.ndarray, "352 2"]:
    """Locate the patches, metres from the sheet's lower left corner, in the order of `patch_colors`."""
    return _lattice((np.arange(COLUMNS) + 0.5) / COLUMNS, 1 - (np.arange(ROWS) + 0.5) / ROWS)


def paper_spots() -> Float[np.ndarray, "315 2"]:
    """Locate the bare paper between each four patches, metres."""
    return _lattice(np.arange(1, COLUMNS) / COLUMNS, 1 - np.arange(1, ROWS) / ROWS)


def patch_size() -> Float[np.ndarray, " 2"]:
    """Give width and height of a patch, metres."""
    return np.subtract(HIGH, LOW) / (COLUMNS, ROWS) * FILLED


def _lattice(across: np.ndarray, up: np.ndarray) -> np.ndarray:
    y, x = np.meshgrid(up, across, indexing="ij")
    return np.array(LOW) + np.stack([x, y], axis=-1).reshape(-1, 2) * np.subtract(HIGH, LOW)


def write_chart(path: Path, dpi: int = 300) -> None:
    """Write the chart as a PDF (or a .png, `dpi` pixels per inch), and beside it a CSV of what each patch sends,
    for those who measure patches one by one. InputError: another kind of file."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("pdf", "png"):
        raise InputError(f"--chart {path}: a .pdf or a .png")
    size = PAGES["A4"]
    figure = Figure(figsize=(size[0] / 0.0254, size[1] / 0.0254), dpi=dpi, facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.axis("off")
    extent = patch_size()
    for centre, color in zip(patch_centres(), patch_colors(), strict=True):
        axes.add_patch(Rectangle(centre - extent / 2, *extent, color=tuple(color), linewidth=0))
    for mark in MARKS:
        for scale, color in ((1, "black"), (5 / 7, "white"), (3 / 7, "black")):
            side = MARK * scale
            axes.add_patch(Rectangle(mark - side / 2, side, side, color=color, linewidth=0))
    draw_foot(
        axes, "cloak calibrate: print as the sheets will be printed, then photograph flat, all four marks in view"
    )
    axes.set(xlim=(0, size[0]), ylim=(0, size[1]))
    made = {"Creator": "cloak", "Producer": None, "CreationDate": None} if kind == "pdf" else {"Software": "cloak"}
    replace_file(path, lambda file: figure.savefig(file, format=kind, metadata=made))
    write_text(path.with_suffix(".csv"), chart_table())


def chart_table() -> str:
    """Write what each patch sends, as CSV; measured values go into the empty columns."""
    lines = ["row,column,sent_r,sent_g,sent_b,seen_r,seen_g,seen_b"]
    for number, color in enumerate(np.round(patch_colors() * 255).astype(int).tolist()):
        row, column = divmod(number, COLUMNS)
        lines.append(f"{row + 1},{column + 1},{','.join(map(str, color))},,,")
    return "\n".join(lines) + "\n"


# --- its photograph: find the marks, undo perspective and the fall of the light

MOST_PIXELS = 1600
"""Of the longer side of the picture in which the marks are looked for."""
LEAST_PATCH = 5.0
"""Pixels: a smaller patch shows its neighbours' colours."""
LIKENESS = 0.7
"""Correlation between the lightness sent and seen under which this is not the chart."""
CORE = 9 / 24
"""Area of a mark's inner square over that of its ring."""


def read_photograph(path: Path) -> Float[np.ndarray, "352 3"]:
    """Read the patches' colours as photographed, sRGB in [0, 1], in the chart's order. InputError: no chart."""
    from PIL import ImageOps

    with open_picture(path) as picture:
        pixels = np.asarray(ImageOps.exif_transpose(picture).convert("RGB"), np.float32) / 255
    homography = _place_chart(pixels, path)
    corners = patch_centres()[0] + patch_size() / 2 * np.array([[-1], [1]])
    if np.abs(np.diff(_projected(homography, corners), axis=0)).min() < LEAST_PATCH:
        raise InputError(f"{path}: the chart's patches are under {LEAST_PATCH:g} pixels; photograph it from nearer")
    seen = to_linear(_means(pixels, homography, patch_centres(), patch_size() * 0.6))
    paper = to_linear(_means(pixels, homography, paper_spots(), patch_size() * 0.1)).mean(axis=1)
    return to_srgb((seen / _light(paper)[:, None]).clip(0, 1))


def _light(paper: Float[np.ndarray, " spots"]) -> Float[np.ndarray, " patches"]:
    """Fit the light on each patch, over its mean: a smooth surface (quadratic in log) through the paper."""
    x, y = ((np.concatenate([paper_spots(), patch_centres()]) - patch_centres().mean(axis=0)) / 0.1).T
    powers = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    fitted = np.linalg.lstsq(powers[: len(paper)], np.log(np.maximum(paper, 1e-3)), rcond=None)[0]
    light = np.exp(powers[len(paper) :] @ fitted)
    return light / light.mean()


def _place_chart(pixels: Float[np.ndarray, "h w 3"], path: Path) -> Float[np.ndarray, "3 3"]:
    """Find the map from the sheet's metres to the picture's pixels, whichever way up it lies."""
    marks = _marks(pixels.mean(axis=2))
    if len(marks) < 4:
        raise InputError(f"{path}: {len(marks)} of the chart's four marks are to be seen")
    lightness = patch_colors().mean(axis=1)
    best = -1.0
    best_homography = np.eye(3)
    for four in itertools.combinations(marks[:8], 4):
        corners = np.array(four)
        around = corners - corners.mean(axis=0)
        # Rows of a picture run downwards: counter-clockwise on the sheet is against the angle here.
        corners = corners[np.argsort(-np.arctan2(around[:, 1], around[:, 0]))]
        for turn in range(4):
            try:
                homography = np.append(perspective(MARKS, np.roll(corners, turn, axis=0)), 1).reshape(3, 3)
            except np.linalg.LinAlgError:  # three of the marks lie on a line
                continue
            seen = _pixels_at(pixels, _projected(homography, patch_centres())).mean(axis=1)
            likeness = float(np.corrcoef(lightness, seen)[0, 1]) if seen.std() > 0 else -1.0
            if likeness > best:
                best, best_homography = likeness, homography
    if best < LIKENESS:
        raise InputError(f"{path}: what lies between the marks is not the chart of `cloak calibrate --chart`")
    return best_homography


def _marks(grey: Float[np.ndarray, "h w"]) -> list[tuple[float, float]]:
    """Find what may be marks, (x, y) in pixels, the best first: a dark ring about a dark square of the same centre."""
    step = max(1, -(-max(grey.shape) // MOST_PIXELS))
    height, width = (extent // step * step for extent in grey.shape)
    small = grey[:height, :width].reshape(height // step, step, width // step, step).mean(axis=(1, 3))
    around = ndimage.uniform_filter(small, max(small.shape) // 8)
    label, count = ndimage.label(small < 0.7 * around, structure=np.ones((3, 3)))
    numbers = np.arange(1, count + 1)
    area = ndimage.sum_labels(np.ones_like(small), label, numbers)
    numbers = numbers[area >= 9]
    area = area[area >= 9]
    centres = np.array(ndimage.center_of_mass(np.ones_like(small), label, numbers)).reshape(-1, 2)
    candidates = []
    for ring in np.argsort(-area):
        side = np.sqrt(area[ring] * 49 / 24)
        near = np.flatnonzero(np.linalg.norm(centres - centres[ring], axis=1) < 0.12 * side)
        for core in near[near != ring]:
            ratio = area[core] / area[ring] / CORE
            if 0.5 < ratio < 2 and side < max(small.shape) / 4:
                # The core's centre: light that spills over an edge moves it least.
                y, x = (centres[core] + 0.5) * step - 0.5
                candidates.append((abs(np.log(ratio)), (float(x), float(y))))
    return [place for _, place in sorted(candidates)]


def _projected(homography: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    moved = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ homography.T
    return moved[:, :2] / moved[:, 2:]


def _means(
    pixels: Float[np.ndarray, "h w 3"], homography: np.ndarray, centres: Float[np.ndarray, "n 2"], extent: np.ndarray
) -> Float[np.ndarray, "n 3"]:
    """Average the colour of each rectangle about these places of the sheet."""
    steps = np.linspace(-0.5, 0.5, 11)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * extent
    places = _projected(homography, (centres[:, None] + offsets).reshape(-1, 2))
    return _pixels_at(pixels, places).reshape(len(centres), -1, 3).mean(axis=1)


def _pixels_at(pixels: Float[np.ndarray, "h w 3"], places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Take the pixels nearest to these places (x, y), at the picture's edge where they leave it."""
    height, width = pixels.shape[:2]
    x, y = np.nan_to_num(places).round().astype(np.int64).T
    return pixels[y.clip(0, height - 1), x.clip(0, width - 1)].astype(np.float64)
