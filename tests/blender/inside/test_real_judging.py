"""What judges a cloak, with the project's own trainer behind the buttons."""

import json
import time

import bpy
import numpy as np
from cloak.result import outputs, render_check
from cloak.session import session
from cloak.trainer import jobs
from cloak.trainer.program import preferences
from cloak.training import run_list
from conftest import run_job
from made import add_camera, made_run, make_egg
from test_export import rig
from test_headless import RED


def test_the_real_trainer_checks_evaluates_films_prints_and_looks(tmp_path, real_trainer, coarse_renders):
    """From the buttons, on a rigged body posed by hand: they are understood, and what comes back is read."""
    obj = make_egg(10)
    bone = rig(obj).pose.bones["spine"]
    bone.rotation_mode = "XYZ"
    bone.rotation_euler.z = 0.4
    ids = np.arange(40, 90)
    run = made_run(tmp_path, obj, ids, np.tile(np.float32([1, 0, 0]), (len(ids), 1)))
    spec = f"python:{RED}:load"
    (run / "config.json").write_text(json.dumps({"format": "cloak run", "detectors": [{"spec": spec}]}))
    obj.cloak.run, preferences().program = str(run), str(real_trainer)
    settings = bpy.context.scene.cloak
    settings.detectors.add().file = str(RED)
    judging = settings.judging
    judging.bodies, judging.frame_start, judging.frame_end = "FRAMES", 1, 1
    judging.images, judging.angle, judging.film_seconds = 8, 90, 0.5
    try:
        bpy.ops.cloak.result_load()
        settings.angle_step = 20
        for press in (
            bpy.ops.cloak.render_check,
            bpy.ops.cloak.evaluate,
            bpy.ops.cloak.turntable,
            bpy.ops.cloak.print_sheets,
        ):
            press()
            assert run_job(200).state == "done", session.job.message
            assert session.job.fraction == 1
        scores = [sight.score for sight in render_check.last_check(run)]
        assert max(scores[:2]) < min(scores[2:])  # the detector's person vanishes as it turns red
        found = run_list.read_state(run).evaluation
        assert found.images == 8 and [s.azimuth for s in found.sectors] == [-180, -90, 0, 90]
        assert found.detectors == (spec,) and all(0 <= rate.value <= 1 for rate in found.rates)
        assert sorted(path.name for path in outputs.made(run)) == ["print sheets", "turntable.gif"]
        add_camera((0, -3, 0.9))
        judging.eye_from = "CAMERA"
        bpy.ops.cloak.eye()
        until = time.monotonic() + 300
        while session.eye.seen is None:
            jobs.tick()
            assert session.eye is not None and time.monotonic() < until, session.job_of("Detector's Eye").message
            time.sleep(0.05)
        clothing, cloak = session.eye.seen.sights
        assert cloak.score < clothing.score and cloak.picture.is_file() and clothing.picture.is_file()
    finally:
        jobs.shut_down()
        preferences().program = ""
