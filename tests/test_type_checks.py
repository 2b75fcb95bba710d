"""Types and shapes of cloak_core are checked while tests run, nested functions' too."""

from typing import TYPE_CHECKING

import numpy as np
import pytest
from beartype import beartype
from jaxtyping import Float64, TypeCheckError

from cloak_core.core.detector.protocol import at_least_float32
from cloak_core.files.caching import cache_folder
from tests.type_checks import check

if TYPE_CHECKING:
    pass

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
