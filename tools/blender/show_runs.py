"""Opens the panel on runs in every state, in a real Blender window, for a screenshot.

    window.sh OUT.png tools/blender/show_runs.py ZIP FOLDER [PANEL ...]

The runs are made by hand, so no trainer is needed; FOLDER is for them. PANEL are the panels to show (default: runs; all
of them with `all`). Every panel is drawn, so one that cannot be drawn ends Blender with exit code 3.
"""

import json
import os
import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import frame, install, play, show_all, show_tab, sidebar, tidy

ZIP, FOLDER, *PANELS = sys.argv[sys.argv.index("--") + 1 :]


def make_run(obj, name: str, last: int, success: float, end: str = "", unseen: tuple = ()) -> Path:
    """A run folder as the trainer leaves it."""
    from cloak.blender import faces
    from cloak.blender.mesh_arrays import topology
    from cloak.exchange.face_lists import write_colors, write_face_list

    run, ids = Path(FOLDER, "cloak runs", name), np.flatnonzero(faces.read_faces(obj, "chest"))
    run.mkdir(parents=True)
    write_face_list(run / "logo.npy", ids, topology(obj))
    write_colors(run / "colors.npy", np.random.default_rng(0).random((len(ids), 3)))
    (run / "config.json").write_text(json.dumps({"format": "cloak run", "detectors": [{"spec": "builtin"}]}))
    events = [{"type": "start", "step": 0, "time": 0, "steps": 600}]
    events += [{"type": "step", "step": s, "time": s / 9, "loss": 0.2, "success": success} for s in (1, last)]
    events += [{"type": "end", "step": last, "time": 70, "outcome": end}] if end else []
    (run / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    if unseen:
        rates = {name: {"success": x} for name, x in zip(("logo", "clothing", "random"), unseen, strict=True)}
        (run / "evaluation").mkdir()
        (run / "evaluation/summary.json").write_text(json.dumps({"detectors": {"builtin": rates}}))
    return run


def make_check(run: Path) -> None:
    """A render check of two angles that the cloak failed at."""
    folder = run / "render check"
    folder.mkdir()
    names = [f"{kind} {angle:+d}.png" for kind in ("cloak", "own") for angle in (-10, 0, 10)]
    for number, name in enumerate(names):
        image = bpy.data.images.new(name, 64, 64)
        image.pixels.foreach_set(np.tile(np.float32([number / 6, 0.4, 0.6, 1]), 64 * 64))
        image.filepath_raw, image.file_format = str(folder / name), "PNG"
        image.save()
    answer = {"scores": [0.2, 0.71, 0.83, 0.99, 0.98, 0.97], "threshold": 0.6}
    (folder / "verdict.json").write_text(json.dumps({"detectors": {"builtin": answer}, "images": names}))


def steps():
    import fcntl

    install(ZIP)
    tidy()
    yield 0.5
    from cloak.blender import faces
    from cloak.session import session
    from cloak.training import run_list
    from made import centers, make_egg

    obj = make_egg()
    x, y, z = centers(obj).T
    faces.new_logo(obj, "chest", (abs(x) < 0.2) & (y < 0) & (z > 0.9) & (z < 1.4))
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(FOLDER, "body.blend")))
    first = make_run(obj, "Body chest", 600, 0.97, "done", (0.94, 0.02, 0.05))
    make_run(obj, "Body chest 2", 600, 0.71, "done", (0.55, 0.02, 0.05))
    make_run(obj, "Body chest 3", 212, 0.45, "stopped")
    make_run(obj, "Body chest 4", 31, 0.1)
    running = make_run(obj, "Body chest 5", 140, 0.33)
    make_check(first)
    held = (running / ".lock").open("a")
    fcntl.flock(held, fcntl.LOCK_EX)
    frame()
    run_list.refresh(bpy.context)
    run_list.select(bpy.context, first)
    bpy.ops.cloak.result_load()
    bpy.ops.cloak.use_standard_view()
    yield from (show_tab() if PANELS == ["all"] else sidebar(*(PANELS or ["runs"])))
    yield 1.5
    states = sorted(state.state for state in session.runs.values())
    assert states == ["done", "done", "failed", "running", "stopped"], states
    Path(os.environ["SHOT_READY"]).touch()
    yield 4.0
    show_all()


play(steps())
