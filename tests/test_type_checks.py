"""Types and shapes of cloak_core are checked while tests run, nested functions' too."""

from typing import TYPE_CHECKING

import numpy as np
import pytest
from beartype import beartype
from jaxtyping import TypeCheckError

from cloak_core.core.detector.protocol import at_least_float32
from cloak_core.files.caching import cache_folder
from tests.type_checks import check

if TYPE_CHECKING:
    pass


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
