"""Records: lists beside them, the shape that is asked for; cells of tables that are no formulas."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cloak_core.files.columns import BYTES_EACH, read_columns, write_columns
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_arrays
from cloak_core.files.records import NOTHING, NUMBER, SHARE, TEXT, WHOLE, as_cell, check_shape

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


LETTERS = np.frombuffer(b"abc", np.uint8)


@pytest.mark.parametrize(
    "damaged",
    [
        lambda folder: (folder / "material.npz").unlink(),
        lambda folder: write_columns(folder, RECORD | {"scene": {"poses": ["x"] * 3}}, LISTS) and None,
        lambda folder: named(folder, text=np.zeros(4 * BYTES_EACH + 1, np.uint8), ends=np.arange(3)),
        lambda folder: named(folder, text=LETTERS, ends=np.arange(4)),
        lambda folder: named(folder, text=LETTERS, ends=np.array([0.5, 1, 2])),
        lambda folder: named(folder, text=np.full(3, 255, np.uint8), ends=np.array([1, 2, 3])),
        lambda folder: named(folder, text=LETTERS),
        lambda folder: named(folder),
        lambda folder: named(folder, rows=np.array(1.0)),
    ],
)
def test_another_file_is_refused_by_name(tmp_path: Path, damaged: Callable[[Path], dict | None]) -> None:
    record = write_columns(tmp_path, RECORD, LISTS)
    record = damaged(tmp_path) or record
    with pytest.raises(InputError, match=r"material\.npz: "):
        read_columns(tmp_path, record)


SHAPE = {"n": WHOLE, "rates": {"*": {"success": SHARE | NOTHING, "box": [NUMBER]}}, "name?": TEXT}
SOUND = {"n": 3, "rates": {"builtin": {"success": None, "box": [1, 2.5]}}, "more": object()}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"n": "3"}, "a.json: n: '3' is not a whole number"),
        ({"n": True}, "n: True is not a whole number"),
        ({"n": float("nan")}, "n: nan is not a whole number"),
        ({"rates": []}, "rates: [] is not a record"),
        ({"rates": {"d": {"success": 1.5, "box": []}}}, "a.json: rates.d.success: 1.5 is not a number from 0 to 1"),
        ({"rates": {"d": {"success": None, "box": [1, "2"]}}}, "box[1]: '2' is not a number"),
        ({"rates": {"d": {"box": []}}}, "a.json: rates.d has no 'success'"),
        ({"rates": {"d": {"success": 0, "box": 7}}}, "box: 7 is not a list"),
        ({"name": None}, "name: None is not text"),
        ({"rates": {"a\nb": {"success": 0, "box": []}}}, "is not a name that can be printed"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named_with_its_place(changes: dict, words: str) -> None:
    with pytest.raises(InputError) as caught:
        check_shape(SOUND | changes, SHAPE, "a.json")
    assert words.split(": ", 1)[-1] in str(caught.value) and str(caught.value).startswith("a.json")


@pytest.mark.parametrize("text", ["=cmd|' /C calc'!A0", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1"])
def test_text_that_a_spreadsheet_takes_for_a_formula_is_marked_as_text(text: str) -> None:
    assert as_cell(text) == f"'{text}"
