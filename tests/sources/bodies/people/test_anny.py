"""Bodies drawn from Anny. The package and its cache are large, so most of it is tested without; `-k real` needs it."""

import sys
from pathlib import Path

import numpy as np
import pytest

from cloak_core.exchange.scenes import write_scene
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.people import anny as module
from cloak_core.sources.bodies.people.anny import SHAPES, anny_bodies, read_anny_poses
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.bodies.people.skeleton import Skeleton
from tests.core.fakes import box_bodies


class FakeSource:
    """The sample mesh on one bone, as high as the drawn height says."""

    def __init__(self) -> None:
        samples = sample_bodies()
        self.quads = samples.loop_vertices.reshape(-1, 4)
        self.rest = samples.vertices[0].astype(float)
        self.weights = np.ones((samples.vertex_count, 1))
        self.drawn: list[dict] = []

    def figure(self, shape: dict) -> tuple[np.ndarray, Skeleton]:
        self.drawn.append(shape)
        return self.rest * shape["height"], Skeleton(["root"], [-1], np.zeros((1, 3)))

    def posed(self, shape: dict, pose: np.ndarray) -> np.ndarray:
        return self.rest @ pose[0, :3, :3].T


@pytest.fixture
def source(monkeypatch: pytest.MonkeyPatch) -> FakeSource:
    source = FakeSource()
    monkeypatch.setattr(module, "AnnySource", lambda: source)
    monkeypatch.setattr(module, "pose_vertices", lambda rest, weights, skeleton, pose: rest)
    return source


def test_bodies_are_those_of_their_seed_and_number(source: FakeSource) -> None:
    few, many = anny_bodies(3, 5, "natural"), anny_bodies(5, 5, "natural")
    assert np.array_equal(few.vertices, many.vertices[:3])
    assert many.names == ("standing-0000", "walking-0001", "running-0002", "waving-0003", "standing-0004")
    assert many.topology == sample_bodies().topology and many.outfit_count == sample_bodies().outfit_count
    assert len({shape["height"] for shape in source.drawn}) == 5
    assert not np.array_equal(anny_bodies(3, 6).vertices, few.vertices)
    for shape in source.drawn:
        assert all(low <= shape[key] <= high for key, (low, high) in SHAPES.items())


def test_a_scene_is_drawn_on_the_spot_or_called_so(
    source: FakeSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert load_scene("anny:4:7:walk[1,3]").names == ("walking-0001", "walking-0003")
    monkeypatch.chdir(tmp_path)
    for spec in ("anny", "anny:many"):
        with pytest.raises(InputError, match="drawn by anny:COUNT"):
            load_scene(spec)
    write_scene("anny", box_bodies())
    assert load_scene("anny").names == box_bodies().names


def test_poses_from_a_file_in_turn(source: FakeSource, tmp_path: Path) -> None:
    poses = np.tile(np.eye(4), (2, 104, 1, 1))
    poses[1, 0, :3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    np.savez(tmp_path / "turns.npz", pose_parameters=poses)
    bodies = anny_bodies(3, 0, tmp_path / "turns.npz")
    assert bodies.names[1] == "turns-0001" and np.array_equal(bodies.vertices[0], bodies.vertices[2])
    assert np.allclose(np.ptp(bodies.vertices[0], axis=0), np.ptp(bodies.vertices[1], axis=0)[[2, 1, 0]], atol=1e-5)
    for name, array, says in (("a.npy", np.zeros((2, 3)), "shape"), ("b.npy", poses * np.nan, "pose 0 is not finite")):
        np.save(tmp_path / name, array)
        with pytest.raises(InputError, match=f"{name}.*{says}"):
            read_anny_poses(tmp_path / name)
    with pytest.raises(InputError, match="neither a file nor one of natural"):
        anny_bodies(1, 0, "dancing")


def test_bad_input_and_a_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="count 0"):
        anny_bodies(0)
    monkeypatch.setitem(sys.modules, "anny", None)
    with pytest.raises(InputError, match=r"anny: needs the package anny: pip install"):
        anny_bodies(1)


@pytest.mark.slow
def test_real_bodies_are_people_of_the_sample_mesh() -> None:
    pytest.importorskip("anny", reason="extra 'anny' is not installed")
    if not (Path.home() / ".cache" / "anny").exists():
        pytest.skip("Anny's cache is not built yet (its first use takes minutes)")
    bodies = anny_bodies(4, 0)
    assert bodies.topology == sample_bodies().topology
    size = np.ptp(bodies.vertices, axis=1)
    assert ((1.3 < size[:, 1]) & (size[:, 1] < 2.3)).all()
    running, waving = size[2], size[3]
    assert running[2] > 0.5, "one leg before, one behind"
    assert waving[0] > 0.45
