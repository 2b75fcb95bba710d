"""Records have the shape that is asked for, or are named; cells are no formulas."""

import pytest

from cloak_core.files.errors import InputError
from cloak_core.files.shapes import NOTHING, NUMBER, SHARE, TEXT, WHOLE, check_shape
from cloak_core.files.tables import as_cell

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
    with pytest.raises(InputError) as said:
        check_shape(SOUND | changes, SHAPE, "a.json")
    assert words.split(": ", 1)[-1] in str(said.value) and str(said.value).startswith("a.json")


@pytest.mark.parametrize("text", ["=cmd|' /C calc'!A0", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1"])
def test_text_that_a_spreadsheet_takes_for_a_formula_is_marked_as_text(text: str) -> None:
    assert as_cell(text) == f"'{text}"
