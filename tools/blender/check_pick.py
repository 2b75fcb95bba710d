"""What only a window can show of picking: the brush and the dragged stamp under a real mouse.

    window.sh OUT.png tools/blender/check_pick.py ZIP [FACES [brush|drag]]

Ends Blender with exit code 3 at the first check that fails; the picture is taken in the middle of a stroke, or of
a drag. Prints the milliseconds that events took on a body of FACES faces (300,000 where none is given).
"""

import os
import statistics
import sys
import time
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import frame, install, override, play, show_tab, tidy, view_area
from mouse import move, xdo

WORDS = sys.argv[sys.argv.index("--") + 1 :]
ZIP, FACES, ONLY = WORDS[0], int(WORDS[1]) if len(WORDS) > 1 else 300_000, "".join(WORDS[2:])
TIMES = {}


def body():
    return bpy.data.objects["Fine"]


def logo_size(name="Logo"):
    from cloak.blender import faces

    return int(faces.read_faces(body(), name).sum()) if name in faces.logo_names(body().data) else 0


def timed(owner, name):
    """Have the times of a method, or of a module's function, noted."""
    function = getattr(owner, name)

    def noted(*words):
        start = time.perf_counter()
        try:
            return function(*words)
        finally:
            TIMES.setdefault(name, []).append(1000 * (time.perf_counter() - start))

    setattr(owner, name, noted)


def check_brush():
    from cloak.logo import paint

    timed(paint, "read_surface")
    for name in ("_touch", "write"):
        timed(paint.CLOAK_OT_logo_paint, name)
    bpy.context.scene.cloak.brush_mirror = True
    with override():
        bpy.ops.wm.tool_set_by_id(name="cloak.paint_logo")
    yield 1.0
    yield from move(0.45, 0.62)
    xdo("mousedown", 1)
    yield 0.5
    yield from move(0.47, 0.5, 8, (0.45, 0.62))
    Path(os.environ["SHOT_READY"]).touch()
    yield 3.0
    xdo("mouseup", 1)
    yield 2.0
    size = logo_size()
    assert size > 100, size
    yield from move(0.45, 0.62)
    xdo("keydown", "ctrl", "mousedown", 1)
    yield 0.5
    xdo("mouseup", 1, "keyup", "ctrl")
    yield 2.0
    smaller = logo_size()
    assert 0 < smaller < size, (smaller, size)
    xdo("key", "ctrl+z")
    yield 2.0
    assert logo_size() == size, "one step of undo takes one stroke back"
    radius = bpy.context.scene.cloak.brush_radius
    xdo("key", "bracketright")
    yield 0.5
    assert bpy.context.scene.cloak.brush_radius > radius
    xdo("key", "f")
    yield 0.5
    yield from move(0.6, 0.5, 4, (0.45, 0.62))
    xdo("click", 1)
    yield 0.5
    assert bpy.context.scene.cloak.brush_radius not in (radius, int(1.1 * radius))
    print("brush: stroke, Ctrl, undo, [ ] and F: ok", flush=True)


def check_drag():
    from cloak.logo import stamp

    timed(stamp.Placed, "faces")
    yield from move(0.5, 0.6)
    window, area = bpy.context.window_manager.windows[0], view_area()
    region = next(r for r in area.regions if r.type == "UI")  # as the panel's button does
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.cloak.stamp_drag("INVOKE_DEFAULT", kind="SMILEY")
    yield from move(0.52, 0.55, 6, (0.5, 0.65))
    for _ in range(3):
        xdo("click", 4)
        yield 0.3
    xdo("key", "r")
    yield from move(0.58, 0.55, 4, (0.52, 0.55))
    xdo("key", "r")
    Path(os.environ["SHOT_READY"]).touch()
    yield 3.0
    assert "Smiley" not in bpy.context.object.data.attributes, "nothing is written before the click"
    xdo("key", "Escape")
    yield 1.0
    assert logo_size("Smiley") == 0
    with bpy.context.temp_override(window=window, area=area, region=region):
        bpy.ops.cloak.stamp_drag("INVOKE_DEFAULT", kind="LETTER")
    yield from move(0.5, 0.5, 3, (0.5, 0.65))
    xdo("click", 1)
    yield 2.0
    assert logo_size("G") > 100, logo_size("G")
    xdo("key", "ctrl+z")
    yield 2.0
    assert logo_size("G") == 0
    print("stamp: drag, wheel, R, Esc, click, undo: ok", flush=True)


def steps():
    install(ZIP)
    tidy()
    from made import make_fine_egg, set_mode

    make_fine_egg(FACES)
    yield 1.0
    frame()
    with override():
        set_mode("EDIT")
        bpy.ops.mesh.select_all(action="DESELECT")
        bpy.ops.ed.undo_push(message="start")
    yield from show_tab()
    yield 1.0
    if ONLY != "drag":
        yield from check_brush()
    if ONLY != "brush":
        yield from check_drag()
    for name, values in TIMES.items():
        print(f"{name}: {statistics.median(values):.0f} ms, at most {max(values):.0f}, of {len(values)}", flush=True)


play(steps())
