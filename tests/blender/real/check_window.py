"""What only a window can show: undo and redo, Edit Mode, closing Blender while it trains.

    real_blender.sh gui sid OUT.png tests/blender/real/check_window.py ZIP PYTHON FOLDER

Ends Blender with exit code 3 at the first check that fails; the picture shows a logo in Edit Mode.
"""

import os
import subprocess
import sys
import traceback
from pathlib import Path

import bpy

ZIP, PYTHON, FOLDER = sys.argv[sys.argv.index("--") + 1 :][:3]
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "inside"))


def window():
    return bpy.context.temp_override(window=bpy.context.window_manager.windows[0])


def press(operator, **options):
    """Call an operator as a button does: with an undo step after it."""
    with window():
        return operator("EXEC_DEFAULT", True, **options)


def steps():
    bpy.ops.extensions.package_install_files(filepath=ZIP, repo="user_default", enable_on_install=True)
    bpy.context.preferences.addons["bl_ext.user_default.cloak"].preferences.python = PYTHON
    from bl_ext.user_default.cloak import colors, faces, jobs, overlay

    sys.modules["cloak"], sys.modules["cloak.faces"] = sys.modules["bl_ext.user_default.cloak"], faces
    subprocess.run(["xdotool", "key", "Escape"], check=True)  # the splash screen
    for other in list(bpy.data.objects):
        bpy.data.objects.remove(other)
    from made import add_ngons, centers, make_egg, set_mode

    obj = make_egg()
    add_ngons(obj)
    obj.shape_key_add(name="Basis")
    obj.shape_key_add(name="Fat")
    x, y, z = centers(obj).T
    faces.new_logo(obj, "chest", (x > 0.05) & (y < 0) & (z > 0.9) & (z < 1.3))
    size = int(faces.read_faces(obj, "chest").sum())
    count = len(obj.data.polygons)
    with window():
        bpy.ops.ed.undo_push(message="start")
    yield 0.5

    press(bpy.ops.cloak.subdivide)
    assert len(bpy.data.objects["Body"].data.polygons) > 4 * count
    with window():
        bpy.ops.ed.undo()
    mesh = bpy.data.objects["Body"].data
    assert len(mesh.polygons) == count and len(mesh.shape_keys.key_blocks) == 2, "undo of Subdivide"
    assert len(mesh.shape_keys.key_blocks["Fat"].data) == len(mesh.vertices)
    with window():
        bpy.ops.ed.redo()
    assert len(bpy.data.objects["Body"].data.polygons) > 4 * count, "redo of Subdivide"
    with window():
        bpy.ops.ed.undo()
    print("undo and redo of Subdivide: ok", flush=True)
    yield 0.5

    press(bpy.ops.cloak.logo_grow)
    grown = int(faces.read_faces(bpy.data.objects["Body"], "chest").sum())
    with window():
        bpy.ops.ed.undo()
    assert faces.read_faces(bpy.data.objects["Body"], "chest").sum() == size < grown, "undo of Grow"
    print("undo of Grow: ok", flush=True)

    settings = bpy.context.scene.cloak
    settings.output, settings.steps, settings.live_seconds = FOLDER, 12, 0.5
    obj = bpy.data.objects["Body"]
    bpy.context.view_layer.objects.active = obj
    press(bpy.ops.cloak.train_start)
    while jobs.current.running:
        yield 0.2
    assert jobs.current.state == "done", jobs.current.message
    obj = bpy.data.objects["Body"]
    assert colors.is_dressed(obj)
    press(bpy.ops.cloak.logo_grow)
    with window():
        bpy.ops.ed.undo()
    assert colors.is_dressed(bpy.data.objects["Body"]), "undoing the next step must not take the colours along"
    print("trained colours keep their own undo step: ok", flush=True)

    obj = bpy.data.objects["Body"]
    press(bpy.ops.cloak.result_toggle)
    bpy.context.view_layer.objects.active = obj
    with window():
        set_mode("EDIT")
        press(bpy.ops.cloak.logo_mirror)
        area = next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == "VIEW_3D")
        with bpy.context.temp_override(area=area, region=next(r for r in area.regions if r.type == "WINDOW")):
            bpy.ops.mesh.select_all(action="SELECT")
            bpy.ops.view3d.view_axis(type="FRONT")
            bpy.ops.view3d.view_selected()
            bpy.ops.mesh.select_all(action="DESELECT")
    assert overlay.active_stats(obj).faces > 1.5 * size
    yield 2.0
    Path(os.environ["SHOT_READY"]).touch()
    yield 3.0
    with window():
        set_mode("OBJECT")
    bpy.context.scene.cloak.steps = 500  # fetched again: undo has replaced what Python held
    press(bpy.ops.cloak.train_start)
    while jobs.current.progress.step < 2:
        yield 0.2
    print("closing with process", jobs.current._process.pid, "in", obj.cloak.run, flush=True)


def run():
    try:
        return next(SCRIPT)
    except StopIteration:
        print("done", flush=True)
    except Exception:
        traceback.print_exc()
        os._exit(3)
    bpy.ops.wm.quit_blender()
    return None


SCRIPT = steps()
bpy.app.timers.register(run, first_interval=1.0)
