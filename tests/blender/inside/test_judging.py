"""Evaluation, its ring, and what is taken along: from the buttons to what they show."""

import json
import math
import os
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from cloak.exchange.face_lists import write_colors
from cloak.result import evaluations, outputs, ring
from cloak.session import session
from cloak.training import panel, run_list, runs
from conftest import drawn, folder_of, run_job, wait_for
from made import add_camera

# --- evaluation ------------------------------------------------------------------------------------------------------


def test_evaluate_tells_how_far_it_is_and_what_came_out(dressed, monkeypatch):
    monkeypatch.setenv("CLOAK_STUB", "slow")
    bpy.ops.cloak.evaluate()
    wait_for(lambda: session.job.progress.step >= 3)
    assert 0.3 < session.job.fraction < 1 and " left" in session.job.describe()
    assert session.job.describe().startswith("Evaluation 3/8") or session.job.progress.step > 3
    job = run_job()
    assert job.state == "done" and not job.is_bad_news, job.message
    assert job.message == "Evaluation done: 240 images of each kind, unseen bodies and unseen backgrounds"
    run_list.refresh(bpy.context)
    found = run_list.selected(bpy.context).evaluation
    rates = {(rate.name, rate.threshold): rate for rate in found.rates}
    assert rates["logo", 0.6].describe() == "50% (45–55)" and rates["logo", 0.5].describe() == "25% (10–20)"
    assert rates["clothing", 0.6].value == 0.1
    assert {"Unseen 50%", "Own clothing 10%", "Random 30%"} <= set(drawn(panel.CLOAK_PT_runs)), "a line each"
    sectors = found.sectors
    assert [s.azimuth for s in sectors] == list(range(-180, 180, 15))
    assert [s.cloak for s in sectors] == [float(abs(s.azimuth) <= 90) for s in sectors]
    assert all(math.isclose(s.clothing, 0.1) for s in sectors)
    assert not found.outdated
    later = time.time() + 10
    write_colors(folder_of(dressed) / "colors.npy", np.zeros((3, 3), np.float32))
    os.utime(folder_of(dressed) / "colors.npy", (later, later))
    assert run_list.read_state(folder_of(dressed)).evaluation.outdated


def test_evaluation_on_frames_exports_them_and_says_so(dressed, tmp_path):
    judging = bpy.context.scene.cloak.judging
    judging.bodies, judging.frame_start, judging.frame_end, judging.frame_step = "FRAMES", 3, 9, 3
    judging.backgrounds = str(tmp_path / "none")
    with pytest.raises(RuntimeError, match=r"Backgrounds folder .*none does not exist"):
        bpy.ops.cloak.evaluate()
    judging.backgrounds, judging.angle = str(tmp_path), 40
    bpy.ops.cloak.evaluate()
    assert "bodies of the training" in run_job().message
    asked = json.loads((folder_of(dressed) / "evaluation/asked.json").read_text())
    assert "--angles=-180:140:40" in asked and f"--backgrounds={tmp_path}" in asked and "--images-per-view=27" in asked
    scene = next(word for word in asked if word.startswith("--scene=")).partition("=")[2]
    with np.load(Path(scene, "bodies.npz")) as arrays:
        assert arrays["names"].tolist() == ["frame 3", "frame 6", "frame 9"]


def test_a_sample_bodys_run_is_judged_on_those_kept_back(dressed):
    run = folder_of(dressed)
    assert not evaluations.kept_back(run)
    for inputs in ({"made_from": "sample:train", "scene": "/x"}, {"scene": "sample:train"}):
        (run / "config.json").write_text(json.dumps({"inputs": inputs, "detectors": []}))
        assert evaluations.kept_back(run)
    (run / "config.json").write_text(json.dumps({"inputs": [], "detectors": []}))
    assert not evaluations.kept_back(run)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"detectors": 3}', '{"detectors": {"a": {"by_angle": {"x": {}}}}}'])
def test_an_evaluation_that_cannot_be_read_is_none(dressed, text):
    (folder_of(dressed) / "evaluation").mkdir()
    (folder_of(dressed) / "evaluation/summary.json").write_text(text)
    assert run_list.read_state(folder_of(dressed)).evaluation is None


# --- the ring --------------------------------------------------------------------------------------------------------


def test_the_ring_is_drawn_for_the_run_that_the_body_wears_and_can_be_hidden(dressed):
    bpy.ops.cloak.evaluate()
    run_job()
    assert ring.shown(bpy.context)[0] == dressed
    place, extent = ring.stand(dressed)
    assert math.isclose(extent, 1.8, abs_tol=1e-3) and place.length < 1e-3
    bpy.context.scene.cloak.judging.ring = False
    assert ring.shown(bpy.context) is None
    bpy.context.scene.cloak.judging.ring = True
    bpy.ops.cloak.result_toggle()
    assert ring.shown(bpy.context) is None  # it belongs to the colours that are worn
    bpy.ops.cloak.result_toggle()
    assert ring.shown(bpy.context) is not None
    dressed.cloak.run = ""
    assert ring.shown(bpy.context) is None


def test_an_azimuth_lies_where_its_camera_stood_and_is_blue_where_nobody_is_found():
    front, left = (evaluations.Sector(azimuth, cloak, None, 1) for azimuth, cloak in ((0.0, 1.0), (90.0, 0.0)))
    places, paints = ring.ring_triangles([left, front])
    half = len(places) // 2
    assert (places[:half, 1] < -0.6).all() and (places[half:, 0] > 0.6).all(), "in front, and to the body's left"
    assert paints[0, 2] > paints[0, 0] and paints[half, 0] > paints[half, 2]
    assert np.abs(np.degrees(np.arctan2(places[:half, 0], -places[:half, 1]))).max() < ring.WIDEST / 2


# --- what is taken along ---------------------------------------------------------------------------------------------


def test_sheets_and_turntables_lie_beside_the_run_numbered(dressed):
    run = folder_of(dressed)
    for name in ("print sheets", "print sheets 2"):
        bpy.ops.cloak.print_sheets()
        assert run_job().message == f"Wrote {name}"
    bpy.ops.cloak.turntable()
    job = run_job()
    assert job.state == "done" and job.fraction == 1
    place = runs.side_folder(run) / "turntable.gif"
    words = json.loads(place.read_text())
    assert "--camera=orbit" in words and "--fps=12.5" in words and "--seconds=6" in words
    assert [path.name for path in outputs.made(run)][-1] == "print sheets" and place in outputs.made(run)
    assert bpy.ops.cloak.show_made(path=str(place)) == {"FINISHED"}
    with pytest.raises(RuntimeError, match="is gone"):
        bpy.ops.cloak.show_made(path="/nowhere")


def test_a_film_follows_the_scenes_camera(dressed):
    with pytest.raises(RuntimeError, match="no camera"):
        bpy.ops.cloak.film()
    scene = bpy.context.scene
    camera = add_camera((0, -2, 0.9))
    scene.frame_start, scene.frame_end, scene.render.fps = 1, 25, 24
    for frame, place in ((1, (0, -2, 0.9)), (25, (4, 0, 0.9))):
        camera.location = place
        camera.keyframe_insert("location", frame=frame)
    scene.frame_set(7)
    scene.cloak.judging.film_format = "mp4"
    bpy.ops.cloak.film()
    assert run_job().state == "done" and scene.frame_current == 7
    words = json.loads((runs.side_folder(folder_of(dressed)) / "film.mp4").read_text())
    assert "--fps=24" in words
    table = next(word for word in words if word.startswith("--camera=")).partition("=")[2]
    rows = np.genfromtxt(table, delimiter=",", names=True)
    first, last = rows[0], rows[-1]
    assert np.allclose([first["azimuth"], first["elevation"], first["distance"]], [0, 0, 2], atol=0.01)
    assert np.allclose([last["time"], last["azimuth"], last["distance"]], [1, 90, 4], atol=0.01)


def test_other_faces_than_the_runs_are_refused(dressed):
    from cloak.body import objects as body

    body.subdivide(dressed)
    with pytest.raises(RuntimeError, match=r"changed since run ä was trained"):
        bpy.ops.cloak.turntable()


# --- people in photographs -------------------------------------------------------------------------------------------


def test_people_wear_the_run_and_the_panel_tells_before_and_after(dressed, tmp_path):
    judging = bpy.context.scene.cloak.judging
    with pytest.raises(RuntimeError, match="People is empty"):
        bpy.ops.cloak.wear()
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    judging.people = str(photographs)
    with pytest.raises(RuntimeError, match=r"no people.json in it"):
        bpy.ops.cloak.wear()
    (photographs / "people.json").write_text(json.dumps({"images": [1, 2, 3, 4], "annotations": []}))
    with pytest.raises(RuntimeError, match=r"poll\(\).*'Body' is none of them: train on the sample body, or carry"):
        bpy.ops.cloak.wear()
    dressed.cloak.made_from = "sample:train|0"
    bpy.ops.cloak.wear()
    job = run_job()
    assert (job.state, job.message) == ("done", "2 people wear it")
    worn = evaluations.last_worn(folder_of(dressed))
    assert (worn.people, worn.left_out, len(worn.pictures)) == (2, 1, 8)
    rates = {rate.name: rate.value for rate in worn.rates if rate.threshold == 0.5}
    assert worn.rates[0].spec == "builtin" and rates == {"run": 0.5, "clothing": 0.0, "grey": 0.05, "random": 0.1}
    assert [path.stem for path in worn.pictures[:2]] == ["before", "after run"]
    bpy.ops.cloak.wear()
    run_job()
    assert evaluations.last_worn(folder_of(dressed)).folder.name == "worn by people 2"
