"""Where the corners of faces lie on a cloth: as the trainer's fragments do."""

import json

import numpy as np
import pytest

from cloak_core.core.cloth import corner_places
from cloak_core.core.polygons import per_corner
from cloak_core.exchange.cloth import cloth_metres, corner_uv
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.people.samples import sample_bodies


def test_corners_lie_where_the_trainer_lays_them():
    """Of quads, in the first of two poses."""
    bodies = sample_bodies("unseen").select_poses([1, 0])
    uv = corner_uv(bodies, 0.25, 0.2)
    corners = corner_places(bodies).transpose(2, 1, 0).reshape(-1, 2)
    wanted = corners[per_corner(bodies, np.arange(len(corners)).reshape(-1, 3))]
    assert (bodies.loop_total == 4).any() and np.allclose(uv * [0.25, -0.2], wanted, atol=1e-6)


@pytest.mark.parametrize(
    "settings", [{}, {"settings": 3}, {"settings": {"tile_cm": 0}}, {"settings": {"tile_cm": "w"}}]
)
def test_a_run_that_does_not_say_how_wide_its_cloth_is(tmp_path, settings):
    (tmp_path / "config.json").write_text(json.dumps(settings))
    with pytest.raises(InputError, match=r"config\.json: does not say how wide cloth\.png is"):
        cloth_metres(tmp_path)
