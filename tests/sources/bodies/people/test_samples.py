import numpy as np
import pytest

from cloak_core.core.geometry import face_areas, outward_parts
from cloak_core.core.logo import select_region
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.people.samples import sample_bodies
from tests.sources.bodies.solids import is_closed


def test_the_splits_share_a_topology_and_no_body() -> None:
    train, unseen, both = (sample_bodies(split) for split in ("train", "unseen", "all"))
    assert (train.pose_count, unseen.pose_count, both.pose_count) == (24, 6, 30)
    assert train.topology == unseen.topology == both.topology
    assert not set(train.names) & set(unseen.names)
    assert {name.split("-")[0] for name in train.names} == {"standing", "walking", "running"}


@pytest.mark.slow
def test_bodies_are_closed_outward_and_stand_on_the_ground() -> None:
    bodies = sample_bodies()
    assert is_closed(bodies.triangles)
    assert outward_parts(bodies).all()
    low, high = bodies.vertices[..., 1].min(axis=1), bodies.vertices[..., 1].max(axis=1)
    assert np.abs(low).max() < 1e-4
    assert 1.45 < (high - low).min() and (high - low).max() < 1.95


@pytest.mark.slow
def test_regions() -> None:
    bodies = sample_bodies()
    wanted = ["chest", "belly", "back", "thighs", "shins", "arms", "forearms", "shirt", "trousers"]
    wanted += ["head", "hands", "feet"]
    assert set(wanted) | {"front"} <= bodies.regions.keys()
    ids = select_region(bodies, "chest+thighs")
    for pose in range(bodies.pose_count):
        areas = face_areas(bodies, pose)
        assert 0.18 < areas[ids].sum() / areas.sum() <= 0.2
    cover = sum(bodies.regions[name].astype(int) for name in ("shirt", "trousers", "head", "hands", "feet"))
    assert (cover == 1).all()
    left = bodies.vertices[0][bodies.loop_vertices.reshape(-1, 4)].mean(axis=1)[:, 0] > 0
    for name in wanted:
        assert abs(np.mean(left[bodies.regions[name]]) - 0.5) < 0.03, name


def test_an_unknown_split_is_refused() -> None:
    with pytest.raises(InputError, match="'sample:testing'"):
        sample_bodies("testing")
