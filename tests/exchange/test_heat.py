"""Which faces a heat map points at."""

import numpy as np
import pytest

from cloak_core.exchange.face_lists import hottest_faces
from cloak_core.files.errors import InputError


def test_the_asked_share_of_the_area_is_taken_by_heat_per_area():
    random = np.random.default_rng(0)
    heat, areas = random.uniform(0.1, 1, 300).astype(np.float32), random.uniform(0.5, 4, 300)
    for share in (0.05, 0.2, 0.7, 1.0):
        ids = hottest_faces(heat, areas, share)
        assert ids.dtype == np.int64 and (np.diff(ids) > 0).all()
        assert areas[ids].sum() / areas.sum() == pytest.approx(share, abs=areas.max() / areas.sum())
        others, density = np.setdiff1d(np.arange(300), ids), heat / areas
        assert not len(others) or density[ids].min() >= density[others].max()


@pytest.mark.parametrize(
    ("heat", "areas", "share", "ids"),
    [
        ([0, 3, 1, 2], [1, 9, 1, 1], 0.25, [2, 3]),  # a large face must have more heat
        ([1, 2], [1, 1], 0.001, [1]),  # however small the share, the hottest face is taken
        ([1, 0, 1, 0], [1, 1, 1, 1], 1.0, [0, 2]),  # what was never seen is left out
        ([1, 1, 1], [1, 0, 1], 1.0, [0, 2]),  # a face without area is not seen
    ],
)
def test_which_faces_are_taken(heat, areas, share, ids):
    assert hottest_faces(np.float32(heat), np.float64(areas), share).tolist() == ids


@pytest.mark.parametrize(
    ("heat", "areas", "share", "words"),
    [
        (np.ones(3), np.ones(3), 0.0, "a share of 0.0"),
        (np.ones(3), np.ones(3), float("nan"), "a share of nan"),
        (np.ones(3), np.ones(4), 0.5, "3 faces for a body of 4"),
        (np.zeros(3), np.ones(3), 0.5, "zero everywhere"),
    ],
)
def test_bad_input(heat, areas, share, words):
    with pytest.raises(InputError, match=words):
        hottest_faces(heat, areas, share)
