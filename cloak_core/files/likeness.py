"""What is nearly the same: pictures re-saved, resized, mirrored or cropped; bodies moved, scaled, shaken a little.

Both are told from a short record of each, so that a run can keep the records of all that it was trained on.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from .crops import packed, parts_of_others

_WAVES = 12
_SIDE = 32
_BITS = _WAVES**2 - 1
_LOOK = re.compile(f"[0-9a-f]{{{2 * -(-_BITS // 8)}}}")
LOOK_DISTANCE = 0.2
"""Share of a look's bits in which the same picture may differ. Measured on 53 photographs: at most 0.04 re-saved or
smaller, 0.14 with 2 % cut off each side, but 0.33 or more for two different ones (procedural scenes: 0.31)."""
_ENOUGH = 512
"""Pixels along a side from which on not every one needs to be looked at."""
_FLAT = 2.0
"""Grey levels (of 255, standard deviation) below which a picture has no look of its own."""
POSE_DISTANCE, POSE_DISTANCE_ANYWHERE = 0.006, 0.02
"""By how much lengths within the same pose may differ, as shares of its size: root mean square, and any of them.

Measured on 154 bodies: noise of a millimetre on every vertex makes 0.0033 at most, any scale 0; bodies kept back differ
from trained ones by 0.014 or more.
"""
_LANDMARKS = 24


def picture_look(pixels: np.ndarray) -> str:
    """The signs of a picture's lowest frequencies as hex digits, a dot, and a small copy of it (see `crops`); "" for a
    picture of a single colour. pixels: [H, W, 3]."""
    height, width = (max(1, extent // _ENOUGH) for extent in pixels.shape[:2])
    grey = pixels[::height, ::width].astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    small = _means(_means(grey).T).T
    if small.std() < _FLAT:
        return ""
    cosines = np.cos(np.pi * (2 * np.arange(_SIDE) + 1) * np.arange(_WAVES)[:, None] / (2 * _SIDE))
    waves = cosines @ small @ cosines.T
    return f"{np.packbits(waves.ravel()[1:] > 0).tobytes().hex()}.{packed(small)}"


def similar_looks(known: Sequence[str], new: Sequence[str]) -> list[tuple[int, int]]:
    """Pairs (index in `known`, index in `new`) of looks of the same picture or of parts of it, mirrored or not."""
    ours, theirs = _signs(known), _signs(new)
    # A mirrored picture has the odd horizontal waves turned over.
    mirrored = np.where(np.arange(1, _BITS + 1) % _WAVES % 2, -1, 1).astype(np.float32)
    agreement = np.maximum(ours @ theirs.T, (ours * mirrored) @ theirs.T)
    same = {(int(i), int(j)) for i, j in np.argwhere(agreement >= _BITS * (1 - 2 * LOOK_DISTANCE))}
    copies = ([look.partition(".")[2] for look in looks] for looks in (known, new))
    return sorted(same | set(parts_of_others(*copies)))


def pose_shape(vertices: np.ndarray) -> list[float]:
    """Lengths (metres) within a pose [V, 3] that no motion of the whole changes: from the vertices' mean and from one
    to the next of some vertices spread over the mesh; the last is the root mean square over all vertices."""
    around = vertices.astype(np.float64) - vertices.mean(0, dtype=np.float64)
    some = around[np.linspace(0, len(around) - 1, _LANDMARKS).round().astype(int)]
    spread = np.sqrt((around**2).sum(1).mean())
    lengths = [np.linalg.norm(some, axis=1), np.linalg.norm(some - np.roll(some, 1, axis=0), axis=1), [spread]]
    return np.concatenate(lengths).round(6).tolist()


def similar_poses(known: Sequence[Sequence[float]], new: Sequence[Sequence[float]]) -> list[tuple[int, int]]:
    """Pairs (index in `known`, index in `new`) of shapes of one pose: moved as a whole, scaled, with noise on it."""
    ours, pairs = _of_size_one(known), []
    for j, shape in enumerate(_of_size_one(new) if len(ours) else ()):
        apart = np.abs(ours - shape)
        near = (np.sqrt((apart**2).mean(1)) <= POSE_DISTANCE) & (apart.max(axis=1) <= POSE_DISTANCE_ANYWHERE)
        pairs += [(int(i), j) for i in np.flatnonzero(near)]
    return pairs


def _of_size_one(shapes: Sequence[Sequence[float]]) -> np.ndarray:
    """Lengths [N, L] by the root mean square of each pose, which is its last; NaN where that is nothing."""
    lengths = np.array(shapes, np.float64).reshape(len(shapes), -1 if len(shapes) else 1)
    size = lengths[:, -1:]
    return np.divide(lengths[:, :-1], size, out=np.full_like(lengths[:, :-1], np.nan), where=size > 0)


def _means(rows: np.ndarray) -> np.ndarray:
    """[32, W] float64: means over 32 equal stretches of the rows [H, W]."""
    sums = np.cumsum(np.concatenate([np.zeros_like(rows[:1]), rows]), axis=0, dtype=np.float64)
    edges = np.linspace(0, len(rows), _SIDE + 1)
    whole = np.minimum(edges.astype(int), len(rows) - 1)
    part = (edges - whole)[:, None]
    return np.diff(sums[whole] * (1 - part) + sums[whole + 1] * part, axis=0) * _SIDE / len(rows)


def _signs(looks: Sequence[str]) -> np.ndarray:
    """[N, bits] float32 of 1 and -1; zeros, which agree with nothing, where a look is missing or no look at all."""
    signs = np.zeros((len(looks), _BITS), np.float32)
    for row, look in zip(signs, looks, strict=True):
        digits = look.partition(".")[0]
        if _LOOK.fullmatch(digits):
            row[:] = np.unpackbits(np.frombuffer(bytes.fromhex(digits), np.uint8))[:_BITS] * 2.0 - 1
    return signs
