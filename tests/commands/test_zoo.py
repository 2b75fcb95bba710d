"""Entries of the zoo: made of a run, read back as a run, refused where damaged; and colours made elsewhere."""

import json

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

import cloak_core
from cloak_core.core.logo import load_logo, make_logo
from cloak_core.core.run_folder import RunFolder
from cloak_core.core.visibility.texture import look_up
from cloak_core.exchange.face_lists import read_colors, read_face_list, write_colors
from cloak_core.exchange.profiles import Profile, write_profile
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies.opening import open_pattern, open_run
from cloak_core.zoo.adding import write_entry
from cloak_core.zoo.entry import SHELF, Entry, entry, names, read_entry, read_start, run_path, shelved


@pytest.fixture
def a_run(tmp_path):
    """A finished run's folder with an evaluation's summary, as far as an entry needs it."""
    shipped = entry(shelved()[0])
    run = shipped.write_run(tmp_path / "run")
    config = read_json(run / "config.json")
    config["inputs"] = {"scene": "/home/someone/bodies.npz[0:4]", "logo": "/home/someone/shirt.npy"}
    config["detectors"][0]["spec"] = "onnx:/home/someone/a.onnx@320"
    (run / "config.json").write_text(json.dumps(config))
    told = {"success": 0.5, "ci95": [0.4, 0.6], "success_own": 0.25, "n": 8, "mean_score": 0.1}
    summary = {
        "detectors": {"onnx:/home/someone/a.onnx@320": {"logo": told, "random": told, "by_angle": {}}},
        "settings": {"controls": ["random"]},
        "white_box": {"onnx:/home/someone/a.onnx@320": True},
        "false_alarms": {"onnx:/home/someone/a.onnx@320": 0.0},
        "unseen": {"bodies": True, "backgrounds": True},
        "inputs": {"bodies": ["x"], "scene": "s", "backgrounds": 3},
    }
    (run / "evaluation").mkdir()
    (run / "evaluation" / "summary.json").write_text(json.dumps(summary))
    return run


def test_a_cloth_goes_with_its_run_and_what_a_killed_writer_left_is_removed(a_run, tmp_path):
    for left in (".cloth.npz.ab12_x9z", ".cloth.json.ab12_x9z", ".other.npz.ab12_x9z"):
        (tmp_path / left).write_bytes(b"half, or somebody else's")
    squares = np.random.default_rng(0).integers(0, 256, (6, 6, 3), np.uint8)
    Image.fromarray(squares).save(a_run / "cloth.png")
    write_entry(tmp_path, "cloth", a_run, about="", licence="CC0-1.0")
    assert {path.name for path in tmp_path.glob(".*")} == {".other.npz.ab12_x9z"}
    back = read_entry(tmp_path, "cloth").write_run(tmp_path / "back")
    assert np.array_equal(np.asarray(Image.open(back / "cloth.png")), squares)


def test_a_run_becomes_an_entry_and_a_run_again(a_run, tmp_path):
    record = write_entry(tmp_path, "mine-1", a_run, about="a test", licence="CC0-1.0", command="cloak train --out /a/b")
    assert (record["detectors"], record["logo"], record["command"]) == (
        ["onnx:a.onnx@320"],
        "shirt",
        "cloak train --out b",
    )
    assert record["evaluation"]["detectors"]["onnx:a.onnx@320"]["logo"]["success_own"] == 0.25
    assert "someone" not in (tmp_path / "mine-1.json").read_text()
    assert names(tmp_path) == ["mine-1"]
    found = read_entry(tmp_path, "mine-1")
    back = found.write_run(tmp_path / "back")
    assert np.abs(read_colors(back / "colors.npy") - read_colors(a_run / "colors.npy")).max() <= 0.5 / 255 + 1e-7
    ours, theirs = read_face_list(back / "logo.npy"), read_face_list(a_run / "logo.npy")
    assert np.array_equal(ours.ids, theirs.ids) and ours.topology == theirs.topology
    with pytest.raises(InputError, match="exists already"):
        found.write_run(tmp_path / "back")


def test_what_is_no_entry_is_refused(a_run, tmp_path):
    write_entry(tmp_path, "mine", a_run, about="", licence="")
    for bad in ("../mine", "Mine", "absent"):
        with pytest.raises(InputError, match="no such entry"):
            read_entry(tmp_path, bad)
    with pytest.raises(InputError, match="--name"):
        write_entry(tmp_path, "a/b", a_run, about="", licence="")
    arrays = dict(np.load(tmp_path / "mine.npz"))
    arrays["colors"][0, 0] ^= 1
    np.savez(tmp_path / "mine.npz", **arrays)
    with pytest.raises(InputError, match="damaged"):
        read_entry(tmp_path, "mine")
    (a_run / "evaluation" / "summary.json").unlink()
    with pytest.raises(InputError, match="no evaluation yet"):
        write_entry(tmp_path, "mine", a_run, about="", licence="")


@pytest.mark.parametrize("name", shelved())
def test_every_shipped_entry_is_sound_small_and_names_no_folder(name):
    found = entry(name)
    assert isinstance(found, Entry) and found.colors.min() >= 0 and found.colors.max() <= 1
    assert found.record["faces"] == len(found.ids) and found.record["command"] and found.record["licence"]
    assert (SHELF / f"{name}.npz").stat().st_size < 64_000
    text = (SHELF / f"{name}.json").read_text()
    assert "/" not in json.dumps(found.record["detectors"]) and "/work" not in text and "/home" not in text


def test_zoo_names_stand_for_run_folders(tmp_path):
    folder = run_path("zoo:builtin-sample")
    assert run_path("zoo:builtin-sample") == folder and (folder / "config.json").exists()
    assert run_path(tmp_path) == tmp_path
    bodies = sample_bodies("unseen")
    logo = load_logo(bodies, folder / "logo.npy")
    colors = read_start(folder, logo)
    pattern, config, name = open_run(folder, read_json(folder / "config.json"), "zoo:builtin-sample", bodies)
    assert np.array_equal(pattern.colors, colors) and config["detectors"] and name == folder.name, "a part of a path"
    assert open_pattern("zoo:builtin-sample", logo, bodies)[2] == "zoo:builtin-sample"
    with pytest.raises(InputError, match="zoo:nothing: no such entry"):
        run_path("zoo:nothing")


def test_colours_of_a_file_and_of_a_picture_on_the_uv_map(tmp_path):
    bodies = sample_bodies("unseen")
    logo = make_logo(bodies, np.arange(100, 140))
    colors = np.random.default_rng(0).random((40, 3)).astype(np.float32)
    write_colors(tmp_path / "c.npy", colors)
    read, config, name = open_pattern(str(tmp_path / "c.npy"), logo, bodies)
    assert np.array_equal(read.colors, colors) and config is None and name == "c"
    with pytest.raises(InputError, match=r"c\.npy: .*40"):
        open_pattern(str(tmp_path / "c.npy"), make_logo(bodies, np.arange(3)), bodies)
    picture = np.random.default_rng(1).integers(0, 255, (64, 96, 3), dtype=np.uint8)
    Image.fromarray(picture).save(tmp_path / "t.png")
    if bodies.uv is None:
        with pytest.raises(InputError, match="no UV map"):
            open_pattern(str(tmp_path / "t.png"), logo, bodies)
        return
    seen = open_pattern(str(tmp_path / "t.png"), logo, bodies)[0].colors
    face = logo.face_ids[7]
    corners = bodies.uv[bodies.triangle_uv[bodies.triangle_face == face]].mean((0, 1))
    expected = look_up(torch.from_numpy(picture), torch.from_numpy(corners.astype(np.float32))[:, None])
    assert np.abs(seen[7] - expected.numpy()[0]).max() < 0.1


def test_a_logo_wears_a_plain_print_as_cloth_and_a_patch_where_the_rig_has_its_chest():
    folder, spec = run_path("zoo:builtin-sample"), "print:checks@tile=0.25"
    bodies, config = sample_bodies("unseen"), read_json(folder / "config.json")
    pattern, training, name = open_run(folder, config, spec, bodies)
    assert (training, name, pattern.period) == (None, spec, 0.25) and set(np.unique(pattern.colors)) == {0.0, 1.0}
    on_faces = pattern.on_faces(pattern.colors)
    assert on_faces.shape == (len(pattern.cover), 3) and 0.3 < on_faces.mean() < 0.7
    patch = open_run(folder, config, "print:checks@patch=0.3", bodies)[0]
    assert 0 < len(patch.cover) < len(pattern.cover)


@pytest.mark.slow
def test_other_colours_are_judged_beside_the_runs_own(tmp_path):
    folder = entry("builtin-sample").write_run(tmp_path / "run")
    bodies = sample_bodies("unseen").select_poses([0])
    grey = np.full((len(read_colors(folder / "colors.npy")), 3), 0.5, np.float32)
    write_colors(tmp_path / "plain.npy", grey)
    how = {"angles": "0", "images_per_view": 1, "bare": 1, "backgrounds": "procedural:test:2"}
    how |= {"size": 96, "shift": 5, "samples": 1, "controls": ("grey",), "resamples": 100}
    for step in (20, 10):
        RunFolder(folder).write_snapshot(step, grey)
    own = cloak_core.evaluate(folder, bodies, over_time=True, **how)
    assert [row["step"] for row in own["over_time"]] == [10, 20] and (folder / "curve.png").stat().st_size > 1000
    snapshot = own["over_time"][0]["detectors"]["builtin"]
    assert snapshot["success"] == own["detectors"]["builtin"]["grey"]["success"]
    other = cloak_core.evaluate(folder, bodies, colors=tmp_path / "plain.npy", **how)
    assert own["white_box"] == {"builtin": True} and other["white_box"] == {"builtin": None}
    rates = other["detectors"]["builtin"]
    assert rates["logo"]["mean_score"] == pytest.approx(rates["grey"]["mean_score"], abs=1e-6)
    assert rates["logo"]["mean_score"] > own["detectors"]["builtin"]["logo"]["mean_score"]
    assert (folder / "evaluation").exists() and (folder / "evaluation-plain").exists()
    # A printer that knows grey alone.
    write_profile(tmp_path / "p.npz", Profile(np.full((2, 2, 2, 3), 0.5, np.float32)))
    rates = cloak_core.evaluate(folder, bodies, profile=tmp_path / "p.npz", **how)["detectors"]["builtin"]
    assert rates["logo"]["mean_score"] == pytest.approx(rates["grey"]["mean_score"], abs=1e-6)
    assert (folder / "evaluation-printed").exists()


@pytest.mark.slow
def test_an_entry_becomes_a_body_that_wears_it(tmp_path, cloak):
    def export(*words: str) -> tuple[int, str]:
        code, _, err = cloak("zoo", "export", *words, "--format", "glb", "--dpi", 20, "--out", tmp_path / "worn.glb")
        return code, err

    assert export("builtin-sample", "--scene", "sample:unseen")[0] == 0
    scene = trimesh.load(tmp_path / "worn.glb")
    (mesh,) = scene.geometry.values()
    bodies = sample_bodies("unseen")
    assert len(mesh.faces) == bodies.triangle_count
    assert np.allclose(mesh.bounds, [bodies.vertices[0].min(0), bodies.vertices[0].max(0)], atol=1e-5)
    # Each face of the logo has its colour where its middle lies on the picture.
    found, picture = (
        entry("builtin-sample"),
        np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"), np.float32),
    )
    triangle = np.flatnonzero(bodies.triangle_face == found.ids[100])[0]
    u, v = mesh.visual.uv[mesh.faces[triangle]].mean(0)
    seen = picture[int((1 - v) * picture.shape[0]), int(u * picture.shape[1])] / 255
    assert np.abs(seen - found.colors[100]).max() < 0.1
    assert "exists already" in export("builtin-sample")[1]
    (tmp_path / "worn.glb").unlink()
    assert "--scene: say which body" in export("transfer-anny")[1]
    assert "topology" in export("transfer-anny", "--scene", "sample")[1]
    assert not (tmp_path / "worn.glb").exists()


def test_an_entry_says_what_it_is_worth_on_people_in_photographs(cloak):
    told = read_entry(SHELF, "yolov8n-anny").record["people"]["detectors"]["onnx:yolov8n.onnx@conf=0.25"]["logo"]
    said = " ".join(cloak("zoo", "show", "yolov8n-anny")[1].split())
    assert f"on {told['n']} people in photographs, judged by onnx yolov8n @conf=0.25: {told['success']:.0%} at" in (
        said.replace(" %", "%")
    )


def test_the_zoo_ships_with_the_built_in_detectors_cloak(cloak):
    listed = {record["name"]: record for record in json.loads(cloak("zoo", "list", "--json")[1])["zoo"]}
    assert listed["builtin-sample"]["detectors"] == ["builtin"] and listed["builtin-sample"]["success"] > 0.9
