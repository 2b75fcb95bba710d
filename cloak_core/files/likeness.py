"""What is nearly the same: pictures re-saved, resized, mirrored or cropped; bodies moved, scaled, shaken a little.

Both are told from a short record of each, so that a run can keep the records of all that it was trained on.

Whether one picture is a part of another is template matching of small grey copies over sizes and places, by their
lowest cosines. Natural pictures have amplitudes that fall with frequency, so each cosine is weighted by its frequency;
otherwise any two pictures with a bright sky would correlate.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np

SIDE = 32
"""Of a copy, pixels."""
ALIKE = 0.93
"""Correlation from which a part is the same picture. Measured on 73 photographs: 0.94 or more for parts of 70 to 96 %
of each side, anywhere, with noise; at most 0.92 for any part of a different picture."""
_CROP_WAVES = 8
_SIZES = np.arange(1, 0.67, -0.04)
_STRETCH = 0.045
"""By how much the two sides of a part may differ, as shares of the picture's."""
MOST_PAIRS = 1 << 24
"""Of pictures that are looked through: a few minutes. Of more, only whole ones are compared."""


def packed(copy: np.ndarray) -> str:
    """A copy [32, 32] of grey levels (0 to 255) as text."""
    return base64.b64encode(copy.round().clip(0, 255).astype(np.uint8).tobytes()).decode()


def unpacked(text: str) -> np.ndarray | None:
    """[32, 32] float32; None for no copy."""
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        return None
    return np.frombuffer(data, np.uint8).reshape(SIDE, SIDE).astype(np.float32) if len(data) == SIDE**2 else None


def parts_are_told(known: Sequence[str], new: Sequence[str]) -> bool:
    """Tell whether `similar_looks` finds parts of pictures: looks of `known` are recorded, few enough, each with its
    copy, or none of `new` shows anything."""
    is_told = 0 < len(known) <= MOST_PAIRS // max(1, len(new)) and all("." in look for look in known if look)
    return is_told or not any(new)


def _parts(whole: list[np.ndarray | None], part: list[np.ndarray | None]) -> Iterator[tuple[int, int]]:
    """Pairs (index in `whole`, index in `part`) of which the second is a part of the first."""
    there = [j for j, copy in enumerate(part) if copy is not None]
    if not there:
        return
    windows, pairs = _windows()
    copies = np.stack([part[j] for j in there])
    signs = np.array([_signature(windows[0] @ c @ windows[0].T) for c in np.concatenate([copies, copies[:, :, ::-1]])])
    for i, copy in enumerate(whole):
        if copy is None:
            continue
        both = np.einsum("akt,blt->abkl", windows @ copy, windows, optimize=True)
        signatures = _signature(both[pairs[:, 0], pairs[:, 1]])  # [parts, 63]: of every part of the picture
        best = (signatures @ signs.T).max(0).reshape(2, len(there)).max(0)
        yield from ((i, there[k]) for k in np.flatnonzero(best >= ALIKE))


@cache
def _windows() -> tuple[np.ndarray, np.ndarray]:
    """Along one side: cosines of the mean levels in eight steps of each window [windows, 8, 32], and which pairs of
    windows, down and across, make a part [pairs, 2]. The first is the whole side."""
    cosines = np.cos(np.pi * (2 * np.arange(_CROP_WAVES) + 1) * np.arange(_CROP_WAVES)[:, None] / (2 * _CROP_WAVES))
    cosines[0] /= np.sqrt(2)
    windows, sizes, pixel = [], [], np.arange(SIDE)
    for size in _SIZES:
        length = size * SIDE
        for start in np.unique([*np.arange(0, SIDE - length + 1e-6), SIDE - length]):
            edges = np.linspace(start, start + length, _CROP_WAVES + 1)[:, None]
            overlap = np.minimum(pixel + 1, edges[1:]) - np.maximum(pixel, edges[:-1])
            windows.append(cosines @ (overlap.clip(0) / (length / _CROP_WAVES)))
            sizes.append(size)
    near = np.abs(np.subtract.outer(sizes, sizes)) <= _STRETCH
    return np.array(windows, np.float32), np.argwhere(near)


def _signature(cosines: np.ndarray) -> np.ndarray:
    """Cosines [..., 8, 8] without the mean, weighted by frequency, of length one."""
    weight = np.hypot(*np.mgrid[:_CROP_WAVES, :_CROP_WAVES]).astype(np.float32)
    flat = (cosines * weight).reshape(*cosines.shape[:-2], -1)[..., 1:]
    return flat / (np.linalg.norm(flat, axis=-1, keepdims=True) + 1e-9)


_WAVES = 12
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
SPREAD_DISTANCE = 1e-4
"""Any of a spread's quantiles. Measured on 146 bodies: 0.000001 for other orders, 0.0017 or more for other bodies."""
_LANDMARKS = 24


def picture_look(pixels: np.ndarray) -> str:
    """The signs of a picture's lowest frequencies as hex digits, a dot, and a small copy of it (`packed`); "" for a
    picture of a single colour. pixels: [H, W, 3]."""
    height, width = (max(1, extent // _ENOUGH) for extent in pixels.shape[:2])
    grey = pixels[::height, ::width].astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    small = _means(_means(grey).T).T
    if small.std() < _FLAT:
        return ""
    cosines = np.cos(np.pi * (2 * np.arange(SIDE) + 1) * np.arange(_WAVES)[:, None] / (2 * SIDE))
    waves = cosines @ small @ cosines.T
    return f"{np.packbits(waves.ravel()[1:] > 0).tobytes().hex()}.{packed(small)}"


def similar_looks(known: Sequence[str], new: Sequence[str]) -> list[tuple[int, int]]:
    """Pairs (index in `known`, index in `new`) of looks of the same picture or of parts of it, mirrored or not.

    Parts are looked for in the first of `known` alone where there are more pairs than `MOST_PAIRS`, see
    `parts_are_told`.
    """
    ours, theirs = _signs(known), _signs(new)
    # A mirrored picture has the odd horizontal waves turned over.
    mirrored = np.where(np.arange(1, _BITS + 1) % _WAVES % 2, -1, 1).astype(np.float32)
    agreement = np.maximum(ours @ theirs.T, (ours * mirrored) @ theirs.T)
    same = {(int(i), int(j)) for i, j in np.argwhere(agreement >= _BITS * (1 - 2 * LOOK_DISTANCE))}
    some = known[: MOST_PAIRS // max(1, len(new))]
    whole, parts = ([unpacked(look.partition(".")[2]) for look in looks] for looks in (some, new))
    return sorted(same | set(_parts(whole, parts)) | {(i, j) for j, i in _parts(parts, whole)})


def pose_shape(vertices: np.ndarray) -> list[float]:
    """Lengths (metres) within a pose [V, 3] that no motion of the whole changes: from the vertices' mean and from one
    to the next of some vertices spread over the mesh; the last is the root mean square over all vertices."""
    around = vertices.astype(np.float64) - vertices.mean(0, dtype=np.float64)
    some = around[np.linspace(0, len(around) - 1, _LANDMARKS).round().astype(int)]
    spread = np.sqrt((around**2).sum(1).mean())
    lengths = [np.linalg.norm(some, axis=1), np.linalg.norm(some - np.roll(some, 1, axis=0), axis=1), [spread]]
    return np.concatenate(lengths).round(6).tolist()


def pose_spread(vertices: np.ndarray) -> list[float]:
    """Quantiles [64] of the vertices' [V, 3] distances from their mean, by the root mean square: no motion of the whole
    changes them, nor another order of the vertices."""
    distances = np.linalg.norm(vertices - vertices.mean(0, dtype=np.float64), axis=1)
    size = np.sqrt((distances**2).mean())
    return (np.quantile(distances, np.linspace(0, 1, 64)) / max(size, 1e-9)).round(7).tolist()


def same_spreads(known: Sequence[Sequence[float]], new: Sequence[Sequence[float]]) -> list[tuple[int, int]]:
    """Pairs (index in `known`, index in `new`) of spreads of one pose."""
    ours = np.array(known, np.float64).reshape(len(known), -1 if len(known) else 1)
    near = [np.abs(ours - spread).max(1) <= SPREAD_DISTANCE for spread in np.array(new)] if len(ours) else []
    return [(int(i), j) for j, matches in enumerate(near) for i in np.flatnonzero(matches)]


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
    edges = np.linspace(0, len(rows), SIDE + 1)
    whole = np.minimum(edges.astype(int), len(rows) - 1)
    part = (edges - whole)[:, None]
    return np.diff(sums[whole] * (1 - part) + sums[whole + 1] * part, axis=0) * SIDE / len(rows)


def _signs(looks: Sequence[str]) -> np.ndarray:
    """[N, bits] float32 of 1 and -1; zeros, which agree with nothing, where a look is missing or no look at all."""
    signs = np.zeros((len(looks), _BITS), np.float32)
    for row, look in zip(signs, looks, strict=True):
        digits = look.partition(".")[0]
        if _LOOK.fullmatch(digits):
            row[:] = np.unpackbits(np.frombuffer(bytes.fromhex(digits), np.uint8))[:_BITS] * 2.0 - 1
    return signs
