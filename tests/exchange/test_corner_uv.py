"""Where the corners of faces lie on a cloth: as the trainer's fragments do."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cloak_core.core.places import corner_places
from cloak_core.core.polygons import per_corner
from cloak_core.exchange.cloth import cloth_metres, corner_uv
from cloak_core.exchange.scenes import read_scene, write_scene
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.people.samples import sample_bodies


def test_corners_lie_where_the_trainer_lays_them():
    """Of quads, in the first of two poses."""
    bodies = sample_bodies("unseen").select_poses([1, 0])
    uv = corner_uv(bodies, 0.25, 0.2)
    corners = corner_places(bodies).transpose(2, 1, 0).reshape(-1, 2)
    wanted = corners[per_corner(bodies, np.arange(len(corners)).reshape(-1, 3))]
    assert (bodies.loop_total == 4).any() and np.allclose(uv * [0.25, -0.2], wanted, atol=1e-6)


def test_cloth_lies_as_in_the_pose_that_the_scene_names(tmp_path):
    """Whatever its poses are; the scene's file keeps it, and images of such bodies are others."""
    bodies = sample_bodies("unseen")
    other = bodies.select_poses([2, 1])
    laid_out = replace(other, laid_out=bodies.vertices[0])
    write_scene(tmp_path / "scene", laid_out)
    for found in (laid_out, read_scene(tmp_path / "scene"), laid_out.select_poses([1])):
        assert (
            np.array_equal(corner_uv(found, 1.0, 1.0), corner_uv(bodies, 1.0, 1.0)) and found.identity != other.identity
        )
        assert np.array_equal(corner_places(found), corner_places(bodies))
    assert np.abs(corner_uv(other, 1.0, 1.0) - corner_uv(bodies, 1.0, 1.0)).max() > 0.05
    assert laid_out.topology == bodies.topology
    with pytest.raises(InputError, match="laid_out: not a finite number at vertex 3"):
        replace(other, laid_out=np.where(np.arange(other.vertex_count)[:, None] == 3, np.nan, bodies.vertices[0]))
    with pytest.raises(InputError, match="laid_out: float32 of shape"):
        replace(other, laid_out=bodies.vertices[0][:5])


@pytest.mark.parametrize(
    "settings", [{}, {"settings": 3}, {"settings": {"tile_cm": 0}}, {"settings": {"tile_cm": "w"}}]
)
def test_a_run_that_does_not_say_how_wide_its_cloth_is(tmp_path, settings):
    (tmp_path / "config.json").write_text(json.dumps(settings))
    with pytest.raises(InputError, match=r"config\.json: does not say how wide cloth\.png is"):
        cloth_metres(tmp_path)
