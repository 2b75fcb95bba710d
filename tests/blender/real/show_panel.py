"""Opens the panel in one of its five states, in a real Blender window, for a screenshot.

    real_blender.sh gui sid OUT.png tests/blender/real/show_panel.py ZIP STATE PYTHON FOLDER

STATE is body, logo, poses, train or result; PYTHON has cloak_core; FOLDER is for runs (for result it may be a finished
run on sample:train). When the window shows the state, the file named by $SHOT_READY is made; a little later Blender
quits. Any error ends Blender with exit code 3.
"""

import os
import subprocess
import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import install, play, until_done

ZIP, STATE, PYTHON, FOLDER = sys.argv[sys.argv.index("--") + 1 :][:4]
PANELS = {
    "body": ("body", "logo"),
    "logo": ("body", "logo"),
    "poses": ("logo", "poses"),
    "train": ("poses", "train"),
    "result": ("train", "result"),
}
HIDDEN = []


def view_area():
    return next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == "VIEW_3D")


def override():
    area = view_area()
    region = next(r for r in area.regions if r.type == "WINDOW")
    return bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area, region=region)


def tidy():
    """The 3D viewport alone, its sidebar on the Cloak tab, the body filling the view."""
    subprocess.run(["xdotool", "key", "Escape"], check=True)  # the splash screen
    with override():
        bpy.ops.screen.screen_full_area(use_hide_panels=False)
    area = view_area()
    area.spaces.active.show_region_ui = True
    area.spaces.active.overlay.show_floor = True


def frame():
    with override():
        bpy.ops.view3d.view_axis(type="FRONT")
        bpy.ops.view3d.view_selected()
        bpy.ops.view3d.view_orbit(angle=0.35, type="ORBITRIGHT")


def sidebar(*names):
    """Show the Cloak tab, and of its panels only those named."""
    yield from show_tab()
    for cls in sys.modules["cloak.panel"].CLASSES:
        short = cls.__name__.removeprefix("CLOAK_PT_")
        if short != cls.__name__ and short not in names and cls.is_registered:
            bpy.utils.unregister_class(cls)
            HIDDEN.append(cls)
    yield from show_tab()


def show_tab():
    for _ in range(3):  # the tab is there once its panels have been drawn
        area = view_area()
        area.tag_redraw()
        yield 0.5
        next(r for r in area.regions if r.type == "UI").active_panel_category = "Cloak"


def steps():
    """One thing after the other; a number means: draw, and come back after so many seconds."""
    install(ZIP, PYTHON)
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
        bpy.ops.cloak.logo_stamp(target="NEW")
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
        from cloak import jobs

        if STATE == "train":
            while jobs.current.progress.step < 30:
                assert jobs.current.running, jobs.current.message
                yield 0.2
        else:
            yield from until_done()
    yield from sidebar(*PANELS[STATE])
    yield 1.5
    Path(os.environ["SHOT_READY"]).touch()
    yield 4.0
    for cls in HIDDEN:
        bpy.utils.register_class(cls)
    if STATE == "train":
        bpy.ops.cloak.train_cancel()
        while jobs.current.running:
            yield 0.2
        assert jobs.current.state == "stopped", jobs.current.message


play(steps())
