"""Fits as they lie on disk: about 160,000 bytes a person.

What is equal is stored once: pixels beyond the body borrow a row of the body. Shares of pixels and shading are 16-bit
steps (of 1 / 65535, and of the shading's range); positions on the body at rest follow from the pose. Everything is then
whole numbers below 65536, their low and high bytes apart, deflated.
"""

from __future__ import annotations

import zlib

import numpy as np
from jaxtyping import Integer
from safetensors.numpy import load, save

from cloak_core.sources.photographs.fitting import Fit, entries_of_rows
from cloak_core.sources.photographs.person import Person
from cloak_core.sources.photographs.posing import Posed
from cloak_core.sources.photographs.shading import LIMITS

STEPS = 65535


def pack_fit(fit: Fit) -> bytes:
    """Pack a fit; its person is not in it."""
    lenders, first, row = np.unique(fit.lender, return_index=True, return_inverse=True)
    counts = np.diff(fit.crow)[first]
    entry = entries_of_rows(fit.crow[first], counts)
    low, high = LIMITS
    numbers = {
        "dressed": _bits(fit.pixels, fit.person.shape),
        "lends": _bits(lenders, fit.person.shape),
        "row": _squeezed(row),
        "count": _squeezed(counts),
        "main": _squeezed(fit.main[first]),
        "triangle": _squeezed(fit.triangle[entry]),
        "share": _squeezed(np.rint(fit.share[entry] * STEPS)),
        "shading": _squeezed(np.rint((fit.shading - low) / (high - low) * STEPS)),
    }
    few = {"tint": fit.tint, "transforms": fit.posed.transforms, "scale": np.array([fit.posed.scale])}
    few |= {f"quality_{name}": np.array([value]) for name, value in fit.quality.items()}
    return save(numbers | {name: np.ascontiguousarray(values, np.float64) for name, values in few.items()})


def read_quality(data: bytes) -> dict[str, float]:
    """Read how well a packed fit fits, and nothing else of it."""
    return _quality(load(data))


def unpack_fit(data: bytes, person: Person) -> Fit:
    """Unpack a person's fit."""
    stored = load(data)
    pixels, lenders = (_from_bits(stored[name], person.shape) for name in ("dressed", "lends"))
    row, count, main, triangle, share, shading = (
        _unsqueezed(stored[name]) for name in ("row", "count", "main", "triangle", "share", "shading")
    )
    start = np.concatenate([[0], np.cumsum(count)])
    share = share / np.repeat(np.maximum(np.add.reduceat(share, start[:-1]), 1), count)  # a pixel is whole
    counts = count[row]
    entry = entries_of_rows(start[row], counts)
    low, high = LIMITS
    return Fit(
        person=person,
        pixels=pixels,
        lender=lenders[row],
        crow=np.concatenate([[0], np.cumsum(counts)]),
        triangle=triangle[entry],
        share=share[entry],
        main=main[row],
        shading=low + shading * ((high - low) / STEPS),
        tint=stored["tint"],
        posed=Posed(stored["transforms"], float(stored["scale"][0])),
        quality=_quality(stored),
    )


def _quality(stored: dict[str, np.ndarray]) -> dict[str, float]:
    return {key.removeprefix("quality_"): float(stored[key][0]) for key in stored if key.startswith("quality_")}


def _bits(pixels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    chosen = np.zeros(shape[0] * shape[1], bool)
    chosen[pixels] = True
    return np.frombuffer(zlib.compress(np.packbits(chosen).tobytes(), 1), np.uint8)


def _from_bits(data: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    return np.flatnonzero(np.unpackbits(np.frombuffer(zlib.decompress(data), np.uint8), count=shape[0] * shape[1]))


def _squeezed(values: np.ndarray) -> np.ndarray:
    """Deflate whole numbers below 65536, their low and high bytes apart: the high ones repeat."""
    if len(values) and not 0 <= values.min() <= values.max() < 1 << 16:
        raise ValueError(f"numbers from {values.min()} to {values.max()} do not fit 16 bits")
    halves = values.astype("<u2").view(np.uint8).reshape(-1, 2).T
    return np.frombuffer(zlib.compress(halves.tobytes(), 1), np.uint8)


def _unsqueezed(data: np.ndarray) -> Integer[np.ndarray, " N"]:
    halves = np.frombuffer(zlib.decompress(data), np.uint8).reshape(2, -1)
    return halves.T.copy().view("<u2").reshape(-1).astype(np.int64)
