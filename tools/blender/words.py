"""Finds words on the screen as a reader does: draws them as Blender draws its labels, and looks where they stand.

What is clipped, covered or below the fold is not found.
"""

import subprocess

import blf
import bpy
import gpu
import numpy as np
from mathutils import Matrix

ALIKE = 0.93
"""Correlation from which on it is the same word; 0.997 and more was seen, of others at most 0.87."""
ALIKE_TURNED = 0.75
"""Of words from top to bottom, whose letters are drawn turned, not turned when drawn."""
FLAT = 4.0
"""Grey levels by which a word must stand out."""


def screen() -> np.ndarray:
    """[H, W] grey levels of the whole screen, row 0 at the top."""
    width, height = map(int, subprocess.check_output(["xdotool", "getdisplaygeometry"]).split())
    raw = subprocess.check_output(["import", "-window", "root", "-depth", "8", "gray:-"])
    return np.frombuffer(raw, np.uint8).reshape(height, width).astype(np.float64)


def drawn(text: str) -> np.ndarray:
    """[h, w] grey levels: the text as it stands on a button, and a pixel around it."""
    preferences = bpy.context.preferences
    size = preferences.ui_styles[0].widget.points * preferences.system.ui_scale
    blf.size(0, size)
    width, height = int(blf.dimensions(0, text)[0]) + 8, int(2 * size)
    buffer = gpu.types.GPUOffScreen(width, height)
    with buffer.bind(), gpu.matrix.push_pop():
        frame = gpu.state.active_framebuffer_get()
        frame.clear(color=(0, 0, 0, 1))
        gpu.matrix.load_matrix(Matrix.Identity(4))
        gpu.matrix.load_projection_matrix(
            Matrix(((2 / width, 0, 0, -1), (0, 2 / height, 0, -1), (0, 0, -1, 0), (0, 0, 0, 1)))
        )
        blf.color(0, 1, 1, 1, 1)
        blf.position(0, 4, int(size / 2), 0)
        blf.draw(0, text)
        pixels = np.array(frame.read_color(0, 0, width, height, 4, 0, "UBYTE").to_list())
    buffer.free()
    grey = pixels.reshape(height, width, 4)[::-1, :, 0].astype(np.float64)
    rows, columns = np.flatnonzero(grey.max(1) > 40), np.flatnonzero(grey.max(0) > 40)
    return grey[rows[0] - 1 : rows[-1] + 2, columns[0] - 1 : columns[-1] + 2]


def places(text: str, image: np.ndarray, turned: bool = False) -> list[tuple[int, int]]:
    """Middles (x, y) of where a text stands in an image [H, W], the topmost first."""
    word = np.rot90(drawn(text), -1) if turned else drawn(text)
    alike = _correlation(image, word)
    found = []
    while alike.max() > (ALIKE_TURNED if turned else ALIKE):
        y, x = np.unravel_index(alike.argmax(), alike.shape)
        found.append((int(x + word.shape[1] / 2), int(y + word.shape[0] / 2)))
        alike[max(0, y - word.shape[0]) : y + word.shape[0], max(0, x - word.shape[1]) : x + word.shape[1]] = 0
    return sorted(found, key=lambda place: (place[1], place[0]))


def _correlation(image: np.ndarray, word: np.ndarray) -> np.ndarray:
    """Normalised cross-correlation at every place where the word fits."""
    shape, (h, w) = image.shape, word.shape
    centred, window = word - word.mean(), np.ones_like(word)

    def sums(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        product = np.fft.rfft2(values) * np.fft.rfft2(weights[::-1, ::-1], shape)
        return np.fft.irfft2(product, shape)[h - 1 :, w - 1 :]

    spread = np.maximum(sums(image**2, window) - sums(image, window) ** 2 / word.size, 0)
    alike = sums(image, centred) / np.sqrt(np.maximum(spread * (centred**2).sum(), 1e-9))
    return np.where(spread > word.size * FLAT**2, alike, 0)
