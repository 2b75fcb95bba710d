import numpy as np
import pytest

from cloak_core.core.geometry import face_areas, inner_edges
from cloak_core.core.logo import select_region
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.scenes import read_scene
from cloak_core.files.errors import InputError
from cloak_core.products.transfer import transfer_logo
from cloak_core.sources.bodies.meshes.subdivision import subdivide
from cloak_core.sources.bodies.people.samples import sample_bodies


@pytest.fixture(scope="module")
def body() -> Bodies:
    return sample_bodies().select_poses([0])


@pytest.fixture(scope="module")
def other(body: Bodies) -> Bodies:
    """The same shape in triangles of another cut, 7 % larger, somewhere else, its vertices shuffled."""
    finer, _ = subdivide(Bodies(body.vertices, body.triangles[:, [2, 1, 0]][:, ::-1]))
    order = np.random.default_rng(0).permutation(finer.vertex_count)
    place = np.argsort(order)
    return Bodies(finer.vertices[:, order] * np.float32(1.07) + np.float32([1, 2, 3]), place[finer.triangles])


def neighbourhood(body: Bodies, ids: np.ndarray) -> np.ndarray:
    """The faces and all that share an edge with them."""
    pairs, _ = inner_edges(body, np.arange(body.face_count))
    touching = np.isin(pairs, ids).any(axis=1)
    return np.union1d(ids, pairs[touching])


@pytest.mark.long
def test_there_and_back(body: Bodies, other: Bodies) -> None:
    ids = select_region(body, "chest+thighs")
    colors = np.random.default_rng(1).random((len(ids), 3)).astype(np.float32)
    there = transfer_logo(body, ids, other, colors)
    assert there.coverage > 0.999 and there.largest_distance < 1e-3 and not len(there.unplaced)
    share = lambda bodies, faces: face_areas(bodies)[faces].sum() / face_areas(bodies).sum()
    assert share(other, there.face_ids) == pytest.approx(share(body, ids), rel=0.02)
    back = transfer_logo(other, there.face_ids, body, there.colors)
    assert np.isin(ids, neighbourhood(body, back.face_ids)).mean() >= 0.95
    assert np.isin(back.face_ids, ids).mean() >= 0.95
    both = np.intersect1d(ids, back.face_ids)
    lost = back.colors[np.searchsorted(back.face_ids, both)] - colors[np.searchsorted(ids, both)]
    assert np.median(np.abs(lost)) < 0.02


@pytest.mark.slow
def test_a_body_onto_itself_is_the_same_logo(body: Bodies) -> None:
    ids = select_region(body, "chest")
    same = transfer_logo(body, ids, body, np.full((len(ids), 3), 0.25, np.float32))
    assert np.array_equal(same.face_ids, ids)
    assert np.allclose(same.colors, 0.25)


@pytest.mark.long
def test_another_person_and_mesh(body: Bodies, shared) -> None:
    target = read_scene(shared / "data" / "bodies_anny.npz")
    ids = select_region(body, "chest+thighs")
    there = transfer_logo(body, ids, target)
    assert there.coverage > 0.9
    areas = face_areas(target)
    assert 0.1 < areas[there.face_ids].sum() / areas.sum() < 0.25
    known = target.regions["chest_thighs"]
    assert areas[there.face_ids][known[there.face_ids]].sum() / areas[there.face_ids].sum() > 0.7
    back = transfer_logo(target, there.face_ids, body)
    assert np.isin(ids, neighbourhood(body, back.face_ids)).mean() >= 0.95


@pytest.mark.slow
def test_what_the_target_lacks_is_named(body: Bodies) -> None:
    """A target without its left thigh."""
    left = body.regions["thighs"] & (body.vertices[0][body.loop_vertices.reshape(-1, 4)].mean(axis=1)[:, 0] > 0)
    target = Bodies(body.vertices, body.triangles[~left[body.triangle_face]])
    ids = select_region(body, "thighs")
    there = transfer_logo(body, ids, target, reach=0.02)
    assert 0.4 < there.coverage < 0.65
    assert left[there.unplaced].all() and len(there.unplaced) > 0.6 * left[ids].sum()


def test_bad_input(body: Bodies) -> None:
    ids = select_region(body, "chest")
    legs = Bodies(body.vertices, body.triangles[body.regions["thighs"][body.triangle_face]])
    with pytest.raises(InputError, match="no face"):
        transfer_logo(body, ids, legs)
    with pytest.raises(InputError, match="colours for 2"):
        transfer_logo(body, ids, body, np.zeros((2, 3), np.float32))
