"""A printer and a camera that exist as arithmetic, to try calibration on: nothing that fits profiles knows them.

The printer lays ink on cloth: amounts from the coded channels, dots that spread (dot gain), colours of overprints mixed
as Yule and Nielsen have it, dull beside a screen's (gamut). The camera sees that in warm light, with channels that mix,
an exposure, a curve of its own, light that falls off, noise, a slanted view and JPEG.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from cloak_core.core.pictures import perspective, read_picture
from cloak_core.exchange.face_lists import read_colors, write_colors
from cloak_core.exchange.profiles import Profile
from cloak_core.files.writing import new_folder, write_bytes
from cloak_core.products.calibration import profile_of
from cloak_core.products.chart import write_chart
from cloak_core.sources.bodies.logos.palette import mean_difference
from cloak_core.sources.bodies.meshes.mesh_file import to_linear, to_srgb

OVERPRINTS = np.array([
    [238, 234, 226], [232, 205, 40], [196, 40, 105], [188, 44, 50],
    [30, 128, 178], [32, 118, 78], [62, 50, 112], [52, 48, 50],
]) / 255  # fmt: skip
"""sRGB of cloth, Y, M, MY, C, CY, CM, CMY."""
YULE_NIELSEN = 1.8
DOT_GAIN = np.array([0.16, 0.2, 0.13])
MIX = np.array([[0.9, 0.08, 0.02], [0.06, 0.88, 0.06], [0.01, 0.12, 0.87]])
WHITE_BALANCE = np.array([1.07, 1.0, 0.83])
EXPOSURE = 0.95
FALL = 0.2
NOISE = 0.012
PRINT_DPI = 120
UNSEEN = 500
"""Colours on which a profile is judged that no chart shows."""


def printed(sent: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Compute the linear light that the cloth gives back where these sRGB colours were sent."""
    ink = 1 - np.asarray(sent, np.float64)
    ink = (ink + 4 * DOT_GAIN * ink * (1 - ink)).clip(0, 1)
    c, m, y = (ink[:, [k]] for k in range(3))
    weights = np.concatenate(
        [(c if i & 4 else 1 - c) * (m if i & 2 else 1 - m) * (y if i & 1 else 1 - y) for i in range(8)], axis=1
    )
    return (weights @ to_linear(OVERPRINTS) ** (1 / YULE_NIELSEN)) ** YULE_NIELSEN


def photographed(light: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Compute the sRGB that the camera makes of linear light; no noise."""
    raw = (light @ MIX.T * WHITE_BALANCE * EXPOSURE).clip(0, 1)
    coded = to_srgb(raw)
    return coded + 0.12 * np.sin(2 * np.pi * (coded - 0.5)) / np.pi  # more contrast in the middle


def come_out(sent: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Compute sRGB as printed and photographed."""
    return photographed(printed(sent)).astype(np.float32)


def photograph(chart: Path, seed: int, turns: int = 0) -> bytes:
    """A JPEG of a printed chart (.png) on a table, seen at a slant; quarter turns as EXIF tells, so that the picture
    is stored lying."""
    random = np.random.default_rng(seed)
    sheet = read_picture(chart)
    codes, which = np.unique(sheet.astype(np.int64) @ (1 << 16, 1 << 8, 1), return_inverse=True)
    colors = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=1)
    light = printed(colors / 255)[which.reshape(-1)].reshape(sheet.shape)
    height, width = sheet.shape[:2]
    margin = width // 8
    frame = (width + 2 * margin, height + 2 * margin)
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) + margin
    corners = corners + random.uniform(-0.35, 0.35, (4, 2)) * margin
    back = perspective(corners, np.array([[0, 0], [width, 0], [width, height], [0, height]], float)).tolist()
    planes = [
        Image.fromarray(light[..., k].astype(np.float32)).transform(
            frame, Image.Transform.PERSPECTIVE, back, Image.Resampling.BILINEAR, fillcolor=0.18
        )
        for k in range(3)
    ]
    scene = np.stack([np.asarray(plane) for plane in planes], axis=-1)
    x, y = np.meshgrid(np.linspace(-1, 1, frame[0]), np.linspace(-1, 1, frame[1]))
    scene = scene * (1 - FALL * ((x - 0.4) ** 2 + (y + 0.3) ** 2) / 2 + FALL / 6)[..., None]
    seen = photographed(scene.reshape(-1, 3)).reshape(scene.shape) + random.normal(0, NOISE, scene.shape)
    picture = Image.fromarray((seen.clip(0, 1) * 255).round().astype(np.uint8)).rotate(90 * turns, expand=True)
    exif = Image.Exif()
    exif[0x0112] = {0: 1, 1: 6, 2: 3, 3: 8}[turns % 4]
    file = io.BytesIO()
    picture.save(file, "JPEG", quality=92, exif=exif)
    return file.getvalue()


@dataclass(frozen=True)
class Tried:
    """What calibration made of the synthetic printer and camera."""

    profile: Profile
    de2000_unseen: float
    """Mean CIEDE2000 between foretold and true, of random colours that no chart shows."""


def try_calibration(out: Path, photographs: int = 1, colors: Path | None = None) -> Tried:
    """Print the chart, photograph it, fit a profile, and judge it; all files go to the new folder `out`.

    colors: a file of colours [L, 3]; what comes out of them is written, too, sent as they are (plain.npy) and as the
    profile says (calibrated.npy).
    """
    with new_folder(out) as folder:
        write_chart(folder / "chart.png", dpi=PRINT_DPI)
        files = []
        for number in range(photographs):
            files.append(folder / f"photograph-{number + 1}.jpg")
            write_bytes(files[-1], photograph(folder / "chart.png", seed=number, turns=number))
        profile = profile_of(files, folder / "profile.npz")
        unseen = np.random.default_rng(7).random((UNSEEN, 3))
        if colors is not None:
            trained = read_colors(colors)
            write_colors(folder / "plain.npy", come_out(trained))
            write_colors(folder / "calibrated.npy", come_out(profile.to_send(trained)))
    return Tried(profile, mean_difference(profile.photographed(unseen), come_out(unseen)))
