"""Try It from an empty file to its picture, and the ready cloths in the Asset Browser.

    window.sh OUT.png tools/blender/show_try_it.py ZIP PYTHON FOLDER

FOLDER gets `status.png` (while it trains) and `assets.png`; OUT.png is the picture before and after, in its window.
Ends Blender with exit code 3 at the first check that fails.
"""

import os
import subprocess
import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import install, play, show_tab, view_area

ZIP, PYTHON, FOLDER = sys.argv[sys.argv.index("--") + 1 :][:3]


def photograph(name):
    subprocess.run(["import", "-window", "root", str(Path(FOLDER, name))], check=True)


def pictures():
    """The images that editors of any window show."""
    areas = [area for window in bpy.context.window_manager.windows for area in window.screen.areas]
    return [area.spaces.active.image for area in areas if area.ui_type == "IMAGE_EDITOR" and area.spaces.active.image]


def show_assets():
    """The Asset Browser with Cloak's library instead of the 3D viewport, for one picture."""
    area = view_area()
    area.ui_type = "ASSETS"
    yield 2.0
    area.spaces.active.params.asset_library_reference = "Cloak"
    yield 5.0
    photograph("assets.png")
    area.ui_type = "VIEW_3D"
    yield 1.0


def steps():
    from cloak.session import session

    subprocess.run(["xdotool", "key", "Escape"], check=True)  # the splash screen
    yield 0.5
    yield from show_assets()
    view_area().spaces.active.show_region_ui = True
    yield from show_tab()
    bpy.context.scene.cloak.output = FOLDER
    bpy.ops.cloak.try_it()
    while session.job.label != "Training" or session.job.progress.step < 30:
        assert session.job.state not in ("failed", "stopped"), session.job.message
        yield 0.2
    photograph("status.png")
    while session.job.active or session.job.label != "Render check":
        assert session.job.state not in ("failed", "stopped"), session.job.message
        yield 0.2
    yield 3.0
    assert not session.job.is_bad_news, session.job.message
    assert [" after: scores, " in image.name for image in pictures()] == [True]
    Path(os.environ["SHOT_READY"]).touch()
    yield 4.0


install(ZIP, PYTHON)
play(steps())
