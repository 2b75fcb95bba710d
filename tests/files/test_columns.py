"""Lists beside a record: what comes back, and what is refused of a file that anyone may have made."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cloak_core.files.columns import BYTES_EACH, read_columns, write_columns
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays

RECORD = {
    "scene": {"faces": 3, "poses": ["a\nb", "", "\udcff é"], "shapes": [[1.0, 0.1], [2.0, float("inf")]]},
    "backgrounds": {"names": [], "strange": [1, "a", None], "ragged": [[1.0], [1.0, 2.0]]},
    "people": None,
}
LISTS = {"scene": ("poses", "shapes", "none"), "backgrounds": ("names", "strange", "ragged"), "people": ("a",)}


def test_lists_come_back_and_what_is_none_stays_in_the_record(tmp_path: Path) -> None:
    kept = json.loads(json.dumps(write_columns(tmp_path, RECORD, LISTS)))
    assert kept["scene"]["poses"].keys() == {"file", "count", "sha256"} and kept["scene"]["faces"] == 3
    assert kept["backgrounds"]["strange"] == [1, "a", None] and kept["backgrounds"]["names"]["count"] == 0
    assert read_columns(tmp_path, kept) == RECORD and read_columns(tmp_path, RECORD) == RECORD


def named(folder: Path, **columns: np.ndarray) -> dict:
    """A record that vouches for columns of 3 texts."""
    np.savez_compressed(folder / "material.npz", **{f"scene.poses/{name}": array for name, array in columns.items()})
    return {"scene": {"poses": {"file": "material.npz", "count": 3, "sha256": sha256_arrays(*columns.values())}}}


TEXT = np.frombuffer(b"abc", np.uint8)


@pytest.mark.parametrize(
    "damaged",
    [
        lambda folder: (folder / "material.npz").unlink(),
        lambda folder: write_columns(folder, RECORD | {"scene": {"poses": ["x"] * 3}}, LISTS) and None,
        lambda folder: named(folder, text=np.zeros(4 * BYTES_EACH + 1, np.uint8), ends=np.arange(3)),
        lambda folder: named(folder, text=TEXT, ends=np.arange(4)),
        lambda folder: named(folder, text=TEXT, ends=np.array([0.5, 1, 2])),
        lambda folder: named(folder, text=np.full(3, 255, np.uint8), ends=np.array([1, 2, 3])),
        lambda folder: named(folder, text=TEXT),
        lambda folder: named(folder),
        lambda folder: named(folder, rows=np.array(1.0)),
    ],
)
def test_another_file_is_refused_by_name(tmp_path: Path, damaged: Callable[[Path], dict | None]) -> None:
    record = write_columns(tmp_path, RECORD, LISTS)
    record = damaged(tmp_path) or record
    with pytest.raises(InputError, match=r"material\.npz: "):
        read_columns(tmp_path, record)
