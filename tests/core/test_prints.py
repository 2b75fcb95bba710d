"""Plain prints: shapes of the size that was said, the right way up, without a seam."""

import numpy as np
import pytest

from cloak_core.core.prints import LIME, PRINT_METRES, PRINTS, SKINS, print_picture
from cloak_core.files.errors import InputError


@pytest.mark.parametrize("name", PRINTS)
def test_a_print_repeats_every_quarter_of_a_metre(name):
    places = np.random.default_rng(0).random((500, 2)) * PRINT_METRES
    colors = PRINTS[name].at(places)
    assert colors.dtype == np.float32 and colors.min() >= 0 and colors.max() <= 1
    for period in ((PRINT_METRES, 0), (0, PRINT_METRES), (-PRINT_METRES, 3 * PRINT_METRES)):
        moved = PRINTS[name].at(places + period)
        assert (abs(moved - colors) < 1e-3).all(axis=1).mean() > 0.99, "all but places on an edge"


def test_a_crowd_is_of_people_the_right_way_up():
    picture = print_picture("crowd").astype(int)
    side = len(picture)
    # The middle of the second row's second person, whom the row below hides from the chest down.
    column = picture[:, side // 3]
    skin = np.flatnonzero((column == np.round(255 * np.array(SKINS[4]))).all(1))
    assert 0.15 < len(skin) / (side / 3) < 0.6 and np.ptp(skin) + 1 == len(skin), "one face"
    assert column[skin.min() - 3].sum() < 0.5 * column[skin.min()].sum(), "hair above it"
    below = picture[skin.max() + 8, side // 3]
    assert np.allclose(below / below.max(), np.array(LIME) / max(LIME), atol=0.02), "a trunk below it"


def test_an_unknown_print_is_named():
    with pytest.raises(InputError, match="print:zigzag: no such print"):
        print_picture("zigzag")
