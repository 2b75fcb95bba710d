"""Opens the panel in one of its five states, in a real Blender window, for a screenshot.

    window.sh OUT.png tools/blender/show_panel.py ZIP STATE PYTHON FOLDER

STATE is body, logo, poses, train or result; PYTHON has cloak_core; FOLDER is for runs (for result it may be a finished
run on sample:train). When the window shows the state, the file named by $SHOT_READY is made; a little later Blender
quits. Any error ends Blender with exit code 3.
"""

import os
import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import frame, install, open_panel, play, show_all, sidebar, tidy, until_done

ZIP, STATE, PYTHON, FOLDER = sys.argv[sys.argv.index("--") + 1 :][:4]
PANELS = {
    "body": ("body", "logo"),
    "logo": ("body", "logo", "stamp"),
    "poses": ("logo", "poses"),
    "train": ("jobs", "poses", "train", "settings"),
    "result": ("train", "runs", "result"),
}
OPENED = {"logo": "stamp", "poses": "poses", "train": "settings"}


def steps():
    """One thing after the other; a number means: draw, and come back after so many seconds."""
    install(ZIP, PYTHON)
    from cloak.session import session
    from cloak.trainer import jobs

    jobs.notify = lambda message: None  # no notice over the body, though the panel is not yet shown
    tidy()
    yield 0.5
    bpy.ops.cloak.add_sample_body()
    yield from until_done()
    frame()
    settings = bpy.context.scene.cloak
    yield 0.5
    obj = bpy.context.view_layer.objects.active
    if STATE != "body":
        settings.stamp_text = "G"
        bpy.ops.cloak.logo_stamp()
    if STATE in ("poses", "train", "result"):
        obj.cloak.logo = "chest"
    if STATE == "result" and Path(FOLDER, "colors.npy").exists():  # a run of sample:train made beforehand
        obj.cloak.run = FOLDER
        bpy.ops.cloak.result_load()
        bpy.ops.cloak.use_standard_view()
    elif STATE in ("train", "result"):
        settings.output, settings.live_seconds = FOLDER, 0.5
        settings.frame_end = 3
        settings.steps = 400 if STATE == "train" else 25
        bpy.ops.cloak.train_start()
        if STATE == "train":
            while session.job.progress.step < 30:
                assert session.job.running, session.job.message
                yield 0.2
        else:
            yield from until_done()
    if STATE in OPENED:
        open_panel(OPENED[STATE])
    yield from sidebar(*PANELS[STATE])
    yield 1.5
    Path(os.environ["SHOT_READY"]).touch()
    yield 4.0
    show_all()
    if STATE == "train":
        bpy.ops.cloak.train_cancel()
        while session.job.running:
            yield 0.2
        assert session.job.state == "stopped", session.job.message


play(steps())
