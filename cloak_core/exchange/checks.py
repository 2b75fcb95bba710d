"""Checks of what files say: the kind, shape, finiteness and indices of arrays, and the version of a format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..files.errors import InputError

FORMAT_VERSION = 1
"""Of the formats; older ones are read, newer ones refused by name."""
MAX_EXTENT = 1 << 24
"""Of an array without elements: nobody counts through 2^40 rows of nothing."""
_KINDS = {"f": ("fiu", "numbers"), "i": ("iu", "integers"), "b": ("b", "booleans"), "u": ("u", "bytes")}
"""For the kind of type that is wanted: the kinds that are taken, and what they are called."""


def checked(value: object, dtype: type, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """The array as `dtype`, contiguous and read-only; None in `shape` stands for any extent.

    It is copied where somebody else could still write to it (see `frozen`). InputError: another kind or shape,
    negative indices.
    """
    array, wanted = np.asarray(value), np.dtype(dtype)
    kinds, called = _KINDS[wanted.kind]
    fits = array.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))
    absurd = not array.size and max(array.shape, default=0) > MAX_EXTENT
    if not fits or absurd or (array.dtype.kind not in kinds and array.size):
        extents = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(f"{name}: {array.dtype} of shape {array.shape}, but {called} of shape ({extents}) are needed")
    if wanted.kind == "i" and array.size and (array.min() < 0 or array.max() > np.iinfo(np.int32).max):
        raise InputError(f"{name}: an index is negative or beyond 2^31")
    ours = np.ascontiguousarray(array, wanted)
    if _is_frozen(ours):
        return ours
    return frozen(ours.copy() if np.may_share_memory(ours, array) else ours)


def frozen(array: np.ndarray) -> np.ndarray:
    """The array, read-only from now on, and what it is a view of: `Bodies` then takes it as it is, without a copy."""
    part = array
    while isinstance(part, np.ndarray):
        part.setflags(write=False)
        part = part.base
    return array


def _is_frozen(array: object) -> bool:
    """Whether nobody can write to this array, nor to one that it is a view of."""
    while isinstance(array, np.ndarray) and not array.flags.writeable:
        array = array.base
    return not isinstance(array, np.ndarray)


def check_finite(array: np.ndarray, name: str, axes: tuple[str, ...]) -> None:
    """InputError names the first value that is no finite number by the first axes' names."""
    if not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0]
        place = ", ".join(f"{axis} {index}" for axis, index in zip(axes, where, strict=False))
        raise InputError(f"{name}: not a finite number at {place}")


def check_indices(array: np.ndarray, count: int, name: str, of: str) -> None:
    """InputError: an index is beyond the `count` things that it is one `of`."""
    if array.size and array.max() >= count:
        raise InputError(f"{name}: index {array.max()} is beyond the {count} {of}")


def check_version(record: dict, kind: str, path: Path) -> None:
    if record.get("format") != kind:
        raise InputError(f"{path}: not a {kind} (its format is {record.get('format')!r})")
    version = record.get("version")
    if not isinstance(version, int) or version < 1:
        raise InputError(f"{path}: version is {version!r}")
    if version > FORMAT_VERSION:
        raise InputError(f"{path}: version {version} is newer than this Cloak reads ({FORMAT_VERSION})")
