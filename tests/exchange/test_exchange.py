"""The file formats: what is written is read back, and what is broken is refused in one line that names it."""

import json
import os
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cloak_core.core.places import corner_places
from cloak_core.core.polygons import per_corner
from cloak_core.exchange.bodies import MAX_FACES, MAX_POSES, Bodies
from cloak_core.exchange.cloth import cloth_metres, corner_uv
from cloak_core.exchange.face_lists import (
    face_ids,
    hottest_faces,
    read_colors,
    read_face_list,
    write_colors,
    write_face_list,
)
from cloak_core.exchange.scenes import read_scene, write_scene
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_npy
from cloak_core.files.writing import write_json
from cloak_core.sources.bodies.people.samples import sample_bodies
from tests.sources.bodies import solids


def cube() -> Bodies:
    """One of two poses that has everything."""
    one = solids.cube(
        face_colors=np.linspace(0, 1, 36).reshape(2, 6, 3),
        regions={"top": np.arange(6) == 3},
        uv=np.zeros((1, 2)),
        triangle_uv=np.zeros((12, 3), int),
        textures={"skin": np.zeros((2, 2, 3), np.uint8)},
        name="cube",
    )
    return replace(one, vertices=np.concatenate([one.vertices, one.vertices + 1]), names=())


def absurd(*shape: int) -> np.ndarray:
    """An array of any shape with an extent of 0, or one number seen many times over: takes no memory."""
    return np.broadcast_to(np.zeros(1, np.float32), shape)


def refused(words: str, call, *arguments):
    with pytest.raises(InputError, match=words) as caught:
        call(*arguments)
    assert "\n" not in str(caught.value)


def test_scene_round_trip(tmp_path):
    bodies = cube()
    write_scene(tmp_path / "scene", bodies)
    back = read_scene(tmp_path / "scene")
    for key in ("vertices", "triangles", "triangle_face", "face_colors", "loop_total", "loop_vertices", "uv"):
        np.testing.assert_array_equal(getattr(back, key), getattr(bodies, key))
        assert getattr(back, key).dtype == getattr(bodies, key).dtype
    assert (back.names, back.name, back.topology) == (bodies.names, "cube", bodies.topology)
    np.testing.assert_array_equal(back.regions["top"], bodies.regions["top"])
    np.testing.assert_array_equal(back.textures["skin"], bodies.textures["skin"])
    assert list(tmp_path.iterdir()) == [tmp_path / "scene"], "no temporary folder stays behind"


def test_topology_ignores_pose_and_triangulation_but_not_loops():
    bodies = cube()
    other_split = bodies.triangles.copy()
    other_split[0], other_split[1] = [0, 1, 2], [1, 3, 2]
    same = Bodies(**{**vars_of(bodies), "triangles": other_split, "vertices": bodies.vertices * 2})
    assert same.topology == bodies.topology
    loops = bodies.loop_vertices.copy()
    loops[[0, 1]] = loops[[1, 0]]
    assert Bodies(**{**vars_of(bodies), "loop_vertices": loops}).topology != bodies.topology


def vars_of(bodies: Bodies) -> dict:
    return {k: v for k, v in vars(bodies).items() if k in Bodies.__dataclass_fields__}


def test_scene_is_never_overwritten(tmp_path):
    write_scene(tmp_path / "scene", cube())
    refused("scene: exists already", write_scene, tmp_path / "scene", cube())


def test_scene_with_a_changed_mesh_is_refused_with_both_hashes(tmp_path):
    folder = write_scene(tmp_path / "scene", cube())
    record = json.loads((folder / "scene.json").read_text())
    record["topology"] = "0" * 64
    (folder / "scene.json").write_text(json.dumps(record))
    refused(f"{'0' * 64}.*{cube().topology}", read_scene, folder)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"vertices": np.full((2, 8, 3), np.nan)}, "vertices: not a finite number at pose 0, vertex 0"),
        ({"triangles": np.full((12, 3), 8)}, "triangles: index 8 is beyond the 8 vertices"),
        ({"triangles": np.full((12, 3), -1)}, "triangles: an index is negative"),
        ({"triangles": np.zeros((12, 4), int)}, r"triangles: .* integers of shape \(any, 3\) are needed"),
        ({"face_colors": np.full((1, 6, 3), 1.5)}, r"face_colors: values outside \[0, 1\]"),
        ({"regions": {"top": np.ones(5, bool)}}, "region_top"),
        ({"loop_total": np.array([4, 4, 4, 4, 4, 2])}, "polygon 5 has fewer than 3 corners"),
        ({"names": ("a", "b", "c")}, "names: 3 for 2 poses"),
        ({"triangle_uv": np.ones((12, 3), int)}, "triangle_uv: index 1 is beyond the 1 uv"),
        ({"triangle_uv": None}, "uv without triangle_uv"),
        # Of absurd extents: refused before anything is counted through.
        ({"vertices": absurd(2**40, 0, 3)}, "vertices: float32 of shape"),
        ({"vertices": absurd(MAX_POSES + 1, 8, 3)}, "1048577 poses"),
        ({"face_colors": absurd(2**40, 0, 3)}, "face_colors: float32 of shape"),
        ({"regions": {"a": absurd(2**40, 0)}}, "region_a: float32 of shape"),
        ({"textures": {"a": absurd(2**40, 0, 3)}}, "texture_a: float32 of shape"),
        ({"triangles": np.broadcast_to(np.arange(3, dtype=np.int32), (MAX_FACES + 1, 3))}, "are beyond any mesh"),
    ],
)
def test_bad_arrays_are_named(change, words):
    started = time.process_time()
    refused(words, lambda: Bodies(**{**vars_of(cube()), **change}))
    assert time.process_time() - started < 5


def test_missing_foreign_and_newer_scenes(tmp_path):
    refused("no such scene", read_scene, tmp_path / "absent")
    refused("no scene.json", read_scene, tmp_path)
    (tmp_path / "scene.json").write_text('{"format": "cloak scene", "version": 99}')
    refused("version 99 is newer", read_scene, tmp_path)
    (tmp_path / "scene.json").write_text('{"format": "something"}')
    refused("not a cloak scene", read_scene, tmp_path)
    (tmp_path / "scene.json").write_text('{"format": ' * 10)
    refused("not valid JSON", read_scene, tmp_path)
    np.savez(tmp_path / "a.npz", vertices=np.zeros((1, 3, 3)))
    refused("no array 'triangles'", read_scene, tmp_path / "a.npz")


@settings(max_examples=50)
@given(st.sets(st.integers(0, 5), min_size=1), st.sampled_from(["<i4", "<u4", "<i8", ">i8", "u1"]), st.randoms())
def test_face_lists_of_every_integer_type_and_order(tmp_path_factory, ids, dtype, random):
    path = tmp_path_factory.mktemp("lists") / "faces.npy"
    shuffled = sorted(ids)
    random.shuffle(shuffled)
    np.save(path, np.array(shuffled, dtype))
    read = read_face_list(path, cube())
    assert read.ids.dtype == np.int64 and read.ids.tolist() == sorted(ids)


def test_face_list_round_trip_and_sidecar(tmp_path):
    bodies = cube()
    write_face_list(tmp_path / "logo.npy", np.array([3, 1], np.int32), bodies.topology)
    stored = np.load(tmp_path / "logo.npy")
    assert stored.dtype == np.int64 and stored.tolist() == [1, 3]
    assert json.loads((tmp_path / "logo.json").read_text())["topology"] == bodies.topology
    other = Bodies(vertices=np.zeros((1, 9, 3)), triangles=np.zeros((9, 3), int))
    refused(
        f"{bodies.topology}, but .* {other.topology}",
        read_face_list,
        tmp_path / "logo.npy",
        other,
    )


def test_reference_lists_count_triangles(tmp_path):
    with open(tmp_path / "reference.idx", "wb") as file:
        np.save(file, np.array([11, 2], np.int32))
    read = read_face_list(tmp_path / "reference.idx", cube())
    assert read.index_of == "triangle"
    assert face_ids(read, cube()).tolist() == [1, 5]
    np.save(tmp_path / "polygons.npy", np.array([11, 2]))
    refused("polygon id 11 is beyond the mesh's 6", read_face_list, tmp_path / "polygons.npy", cube())


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.array([1, 2, 2]), r"duplicate face id 2 \(2 times\)"),
        (np.array([1, -2]), "negative face id -2"),
        (np.array([1.0, 2.0]), "not float64"),
        (np.array([[1, 2]]), r"shape \(1, 2\)"),
        (np.array([True]), "not bool"),
        (np.array([], int), "empty"),
        (np.array([2**40]), "beyond any mesh"),
        (np.array([2**64 - 1], np.uint64), "beyond any mesh"),
        (np.array([6]), "polygon id 6 is beyond the mesh's 6"),
    ],
)
def test_bad_face_lists_are_refused_by_name(tmp_path, array, words):
    np.save(tmp_path / "logo.npy", array)
    refused(f"logo.npy: .*{words}", read_face_list, tmp_path / "logo.npy", cube())


def test_nothing_is_unpickled(tmp_path):
    np.save(tmp_path / "evil.npy", np.array([print], object), allow_pickle=True)
    refused("Python objects", read_npy, tmp_path / "evil.npy")
    np.savez(tmp_path / "evil.npz", vertices=np.array([print], object), triangles=np.zeros((1, 3), int))
    refused("Python objects", read_scene, tmp_path / "evil.npz")


def test_colors(tmp_path):
    write_colors(tmp_path / "colors.npy", np.array([[0, 0.5, 1]]))
    assert read_colors(tmp_path / "colors.npy", 1).dtype == np.float32
    refused("colours for 1 faces, but the logo has 2", read_colors, tmp_path / "colors.npy", 2)
    np.save(tmp_path / "colors.npy", np.array([[0, 0.5, np.nan]]))
    refused("outside", read_colors, tmp_path / "colors.npy")


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    write_json(tmp_path / "a.json", {"old": 1})

    def no_space(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    refused("a.json: cannot be written .No space left", write_json, tmp_path / "a.json", {"new": 1})
    assert json.loads((tmp_path / "a.json").read_text()) == {"old": 1}
    assert len(list(tmp_path.iterdir())) == 1


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


@pytest.mark.parametrize("settings", [3, {"tile_cm": 0}, {"tile_cm": "w"}])
def test_a_run_that_does_not_say_how_wide_its_cloth_is(tmp_path, settings):
    (tmp_path / "config.json").write_text(json.dumps({"settings": settings}))
    refused(r"config\.json: does not say how wide cloth\.png is", cloth_metres, tmp_path)
