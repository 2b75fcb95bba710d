"""Which faces a heat map points at."""

import numpy as np
import pytest

from cloak_core.exchange.heat import hottest_faces
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


def test_a_large_face_must_have_more_heat():
    assert hottest_faces(np.array([0.0, 3, 1, 2]), np.array([1.0, 9, 1, 1]), 0.25).tolist() == [2, 3]


def test_the_hottest_face_is_taken_however_small_the_share():
    assert hottest_faces(np.array([1.0, 2]), np.ones(2), 0.001).tolist() == [1]


def test_what_was_never_seen_is_left_out():
    heat = np.where(np.arange(20) < 5, 1.0, 0.0)
    assert hottest_faces(heat, np.ones(20), 1.0).tolist() == [0, 1, 2, 3, 4]
    assert hottest_faces(np.ones(3), np.array([1.0, 0, 1]), 1.0).tolist() == [0, 2]  # a face without area is not seen


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
