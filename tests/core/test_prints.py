"""Plain prints: shapes of the size that was said, the right way up, without a seam."""

import numpy as np
import pytest

from cloak_core.core.prints import PRINT_METRES, PRINTS, print_picture
from cloak_core.files.errors import InputError


@pytest.mark.parametrize("name", PRINTS)
def test_a_print_repeats_every_quarter_of_a_metre(name):
    places = np.random.default_rng(0).random((500, 2)) * PRINT_METRES
    colors = PRINTS[name].at(places)
    assert colors.dtype == np.float32 and colors.min() >= 0 and colors.max() <= 1
    for period in ((PRINT_METRES, 0), (0, PRINT_METRES), (-PRINT_METRES, 3 * PRINT_METRES)):
        moved = PRINTS[name].at(places + period)
        assert (abs(moved - colors) < 1e-3).all(axis=1).mean() > 0.99, "all but places on an edge"


def test_an_unknown_print_is_named():
    with pytest.raises(InputError, match="print:zigzag: no such print"):
        print_picture("zigzag")
