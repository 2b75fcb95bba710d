"""Long lists beside a record: a column each in a compressed .npz, named in the record by file, length and digest.

A record stays as short as it is, however much material it is about. Lists are of text, or of rows of numbers that are
equally long.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .errors import InputError, first_line
from .identity import sha256_arrays
from .reading import read_npz
from .writing import write_npz

FILE = "material.npz"
BYTES_EACH = 8 << 10
"""Of one item in memory: as much is read as the lengths in the record allow. The longest are paths, of 4 KiB."""


def write_columns(folder: Path, record: Mapping[str, object], lists: Mapping[str, Sequence[str]]) -> dict:
    """Write lists of a record to FOLDER/material.npz; return the record with their file and digests in their place.

    lists: their keys within the parts of the record, by part; what is no list of text or rows stays where it is.
    InputError: an item takes more than `BYTES_EACH`.
    """
    columns: dict[str, np.ndarray] = {}
    kept = dict(record)
    for part, keys in lists.items():
        values = record.get(part)
        for key in keys if isinstance(values, dict) else ():
            own = _packed(values.get(key))
            if own is None:
                continue
            count, name = len(values[key]), f"{part}.{key}"
            if sum(array.nbytes for array in own.values()) > _bound(count):
                raise InputError(f"{name}: takes more than {BYTES_EACH:,} bytes an item")
            columns |= {f"{name}/{kind}": array for kind, array in own.items()}
            kept[part] = kept[part] | {key: {"file": FILE, "count": count, "sha256": sha256_arrays(*own.values())}}
    write_npz(folder / FILE, compressed=True, **columns)
    return kept


def read_columns(folder: Path, record: Mapping[str, object]) -> dict:
    """Return a record with the lists that `write_columns` took from it; one that has all of its lists stays as it is.

    InputError: the file is not there, is damaged or another record's.
    """
    parts = [(part, values) for part, values in record.items() if isinstance(values, dict)]
    named = {(part, key): value for part, values in parts for key, value in values.items() if _is_named(value)}
    path, kept = folder / FILE, dict(record)
    arrays = read_npz(path, sum(_bound(value["count"]) for value in named.values())) if named else {}
    for (part, key), value in named.items():
        name = f"{part}.{key}/"
        own = {column.removeprefix(name): array for column, array in arrays.items() if column.startswith(name)}
        try:
            if sha256_arrays(*own.values()) != value["sha256"]:
                raise ValueError("another run's, or changed")
            kept[part] = kept[part] | {key: _unpacked(own, value["count"])}
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: {part}.{key} is not what the record names ({first_line(error)})") from None
    return kept


def _is_named(value: object) -> bool:
    """Tell whether this stands for a list in the file."""
    is_ours = isinstance(value, dict) and value.keys() == {"file", "count", "sha256"} and value["file"] == FILE
    return is_ours and isinstance(value["count"], int) and value["count"] >= 0


def _bound(count: int) -> int:
    return (count + 1) * BYTES_EACH


def _packed(values: object) -> dict[str, np.ndarray] | None:
    """Make columns of a list of text, or of rows of numbers; None of anything else."""
    if not isinstance(values, list):
        return None
    if all(isinstance(value, str) for value in values):
        texts = [value.encode(errors="surrogatepass") for value in values]  # file names need not be UTF-8
        ends = np.cumsum([len(text) for text in texts], dtype=np.int64)
        return {"text": np.frombuffer(b"".join(texts), np.uint8), "ends": ends}
    try:
        rows = np.array(values, np.float64)
    except (TypeError, ValueError):
        return None
    return {"rows": rows} if rows.ndim == 2 else None


def _unpacked(columns: Mapping[str, np.ndarray], count: int) -> list:
    """Make the list of its columns. KeyError, TypeError, ValueError: they are none, or of another length."""
    if "rows" in columns:
        values = columns["rows"].tolist()
    else:
        data, ends = columns["text"].tobytes(), columns["ends"].tolist()
        values = [data[a:b].decode(errors="surrogatepass") for a, b in zip([0, *ends], ends, strict=False)]
    if len(values) != count:
        raise ValueError(f"{len(values)} items instead of {count}")
    return values
