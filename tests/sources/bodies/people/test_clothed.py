import numpy as np
import pytest

from cloak_core.core.cameras import Camera
from cloak_core.core.geometry import connected_parts, face_areas
from cloak_core.core.logo import load_logo, select_region
from cloak_core.core.visibility.settings import RenderSettings
from cloak_core.exchange.scenes import read_scene, write_scene
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.people.clothed import DATA, OBJECTS, clothed_bodies
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.bodies.view_cache import ViewCache


def clips(names: tuple[str, ...]) -> dict[str, list[int]]:
    """Poses by the cycle they belong to, in their order."""
    found: dict[str, list[int]] = {}
    for pose, name in enumerate(names):
        found.setdefault(name.rpartition("-")[0], []).append(pose)
    return found


@pytest.mark.slow
def test_the_splits_share_a_topology_and_neither_people_nor_folds() -> None:
    train, unseen = clothed_bodies("train"), clothed_bodies("unseen")
    assert train.topology == unseen.topology == clothed_bodies("train", tight=True).topology
    parts = [[name.split("-") for name in clips(bodies.names)] for bodies in (train, unseen)]
    for field in (1, 2):
        assert not {p[field] for p in parts[0]} & {p[field] for p in parts[1]}
    motions = [{p[0] for p in part} for part in parts]
    assert motions[0] == {"walking", "running", "standing"} and "waving" in motions[1] - motions[0]
    assert train.pose_count + unseen.pose_count == clothed_bodies().pose_count


@pytest.mark.slow
def test_body_shirt_and_trousers_are_three_objects_numbered_through() -> None:
    bodies = clothed_bodies("unseen")
    owner = np.stack([bodies.regions[name] for name in OBJECTS])
    assert (owner.sum(0) == 1).all()
    assert (np.diff(owner.argmax(0)) >= 0).all()
    quads = bodies.loop_vertices.reshape(-1, 4)
    corners = [set(quads[mask].ravel()) for mask in owner]
    assert not (corners[0] & corners[1] or corners[0] & corners[2] or corners[1] & corners[2])
    for number in (1, 2):  # each garment is one piece of cloth
        assert len(np.unique(connected_parts(quads[owner[number]], bodies.vertex_count)[quads[owner[number], 0]])) == 1
    logo = load_logo(bodies, region="shirt+trousers")
    assert set(logo.face_ids) == set(np.flatnonzero(owner[1] | owner[2]))
    assert 0 < len(select_region(bodies, "chest+thighs")) < len(logo)
    # What cloth hides is not there, so that it costs nothing.
    skin, samples = owner[0].sum(), sample_bodies("unseen")
    assert skin < samples.face_count and len(logo) + skin < 1.1 * samples.face_count


@pytest.mark.slow
@pytest.mark.parametrize("tight", [False, True])
def test_cycles_close_and_cloth_does_not_tear(tight: bool) -> None:
    """The step from a cycle's last frame to its first is like the others; no face grows beyond what cloth gives."""
    bodies = clothed_bodies("all", tight)
    cloth = np.unique(bodies.triangles[bodies.regions["shirt"][bodies.triangle_face]])
    for name, poses in clips(bodies.names).items():
        frames = bodies.vertices[poses][:, cloth].astype(np.float64)
        step = np.linalg.norm(np.roll(frames, -1, axis=0) - frames, axis=2).mean(1)
        assert step[-1] < 1.6 * step[:-1].max() + 1e-3, name
        areas = np.stack([face_areas(bodies, pose) for pose in poses[::4]])[:, ~bodies.regions["body"]]
        total = areas.sum(1)
        assert total.max() < 1.15 * total.min(), name
        low = bodies.vertices[poses][..., 1].min(1)
        assert (np.abs(low) < 0.03).all(), name


@pytest.mark.slow
def test_no_skin_shows_through_the_cloth() -> None:
    """Of upper arms, ankles and neck about as much is seen as of people in tight clothes, and no hips or belly."""
    loose, tight = shown_skin(tight=False), shown_skin(tight=True)
    assert loose.max() < 0.06 and loose.mean() < tight.mean() + 0.015


def shown_skin(tight: bool) -> np.ndarray:
    """In views from four sides: what skin that is neither of head, hands, feet nor forearms takes of the person."""
    bodies = clothed_bodies("unseen", tight)
    skin = bodies.regions["body"].copy()
    skin[select_region(bodies, "head+hands+feet+forearms")] = False
    view_cache, shares = ViewCache(bodies, RenderSettings(samples=1)), []
    for pose in range(0, bodies.pose_count, 7):
        for view in view_cache.views(
            [(pose, Camera(azimuth=azimuth, width=160, height=160)) for azimuth in range(0, 360, 90)]
        ):
            seen = np.bincount(view.map.column.numpy(), view.map.weight.numpy(), bodies.face_count)
            shares.append(seen[skin].sum() / seen.sum())
    return np.array(shares)


@pytest.mark.slow
def test_names_and_files(tmp_path) -> None:
    walk = load_scene("sample-clothed:unseen[walking*]")
    assert walk.pose_count > 8 and all(name.startswith("walking") for name in walk.names)
    assert load_scene("sample-tight:unseen[walking*]").names == walk.names
    again = read_scene(write_scene(tmp_path / "scene", walk))
    assert again.topology == walk.topology and np.array_equal(again.vertices, walk.vertices)
    with pytest.raises(InputError, match="sample-clothed:nobody"):
        load_scene("sample-clothed:nobody")
    assert DATA.stat().st_size < 4e6
