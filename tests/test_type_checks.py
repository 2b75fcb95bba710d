"""Types and shapes of cloak_core are checked while tests run, nested functions' too."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest
from beartype import beartype
from jaxtyping import Float64, TypeCheckError

from cloak_core.core.detector.protocol import at_least_float32
from cloak_core.files.caching import cache_folder
from tests.type_checks import check

if TYPE_CHECKING:
    from nowhere import Unknown

Row = Float64[np.ndarray, " n"]


def checked(function):
    return check(typechecker=beartype)(function)


def test_what_the_tests_import_is_checked() -> None:
    with pytest.raises(TypeCheckError):
        cache_folder(3)
    with pytest.raises(TypeCheckError):
        at_least_float32(np.zeros(3, np.float32))


def test_types_are_checked() -> None:
    @checked
    def double(value: int, *, times: int = 2) -> int:
        return value * times if value else "nothing"

    assert double(3) == 6 and double.__name__ == "double"
    for wrong in (lambda: double("3"), lambda: double(3, times="2"), lambda: double(0)):
        with pytest.raises(TypeCheckError):
            wrong()
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        double()


def test_axes_have_one_size_in_a_call_and_its_result() -> None:
    @checked
    def add(a: Row, b: Row | None = None, cut: int = 0) -> Row:
        return (a + (0 if b is None else b))[cut:]

    assert len(add(np.ones(3), np.ones(3))) == 3 and len(add(np.ones(2))) == 2
    for wrong in ((np.ones(3), np.ones(1)), (np.ones(3), None, 1), (np.ones((3, 1)),)):
        with pytest.raises(TypeCheckError):
            add(*wrong)


def test_a_function_that_is_defined_anew_is_checked_and_sees_its_own_surroundings() -> None:
    def define(offset: int):
        @checked
        def shift(value: int) -> int:
            return value + offset

        @checked
        def plain(value):
            return value + offset

        return shift, plain

    made = [define(offset) for offset in (1, 2.5)]
    assert made[0][0](1) == 2 and [plain(1) for _, plain in made] == [2, 3.5]
    for shift in (made[0][0], made[1][0]):
        with pytest.raises(TypeCheckError):
            shift("1")
    with pytest.raises(TypeCheckError):
        made[1][0](1)


def test_rows_that_are_yielded_and_names_for_type_checkers_alone_are_let_through() -> None:
    @checked
    def rows(count: int) -> Iterator[Row]:
        yield from np.ones((count, 2))

    @checked
    def of_unknown(value: "Unknown", count: int) -> int:
        return count

    assert len(list(rows(3))) == 3 and of_unknown(None, 2) == 2
    for wrong in (lambda: rows("3"), lambda: of_unknown(None, "2")):
        with pytest.raises(TypeCheckError):
            wrong()
