"""What only a window can show: undo and redo, Edit Mode, closing Blender while it trains.

    window.sh OUT.png tools/blender/check_window.py ZIP PYTHON FOLDER

Ends Blender with exit code 3 at the first check that fails; the picture shows a logo in Edit Mode.
"""

import os
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import install, play, until_done

ZIP, PYTHON, FOLDER = sys.argv[sys.argv.index("--") + 1 :][:3]


def window():
    return bpy.context.temp_override(window=bpy.context.window_manager.windows[0])


def press(operator, **options):
    """Call an operator as a button does: with an undo step after it."""
    with window():
        return operator("EXEC_DEFAULT", True, **options)


def assign_all():
    """Let the logo have every face: a step of undo."""
    from cloak.blender import faces
    from cloak.blender.mesh_arrays import face_count

    faces.select_faces(body(), np.ones(face_count(body()), bool))
    press(bpy.ops.cloak.logo_assign)


def undo():
    with window():
        bpy.ops.ed.undo()


def body():
    """Fetched again each time: undo replaces what Python holds."""
    return bpy.data.objects["Body"]


def logo_size():
    from cloak.blender import faces

    return int(faces.read_faces(body(), "chest").sum())


def make_body():
    from cloak.blender import faces
    from made import add_ngons, centers, make_egg

    obj = make_egg()
    add_ngons(obj)
    obj.shape_key_add(name="Basis")
    obj.shape_key_add(name="Fat")
    x, y, z = centers(obj).T
    faces.new_logo(obj, "chest", (x > 0.05) & (y < 0) & (z > 0.9) & (z < 1.3))
    with window():
        bpy.ops.ed.undo_push(message="start")


def check_undo():
    count, size = len(body().data.polygons), logo_size()
    press(bpy.ops.cloak.subdivide)
    assert len(body().data.polygons) > 4 * count
    undo()
    mesh = body().data
    assert len(mesh.polygons) == count and len(mesh.shape_keys.key_blocks) == 2, "undo of Subdivide"
    assert len(mesh.shape_keys.key_blocks["Fat"].data) == len(mesh.vertices)
    with window():
        bpy.ops.ed.redo()
    assert len(body().data.polygons) > 4 * count, "redo of Subdivide"
    undo()
    print("undo and redo of Subdivide: ok", flush=True)
    yield 0.5
    assign_all()
    grown = logo_size()
    undo()
    assert logo_size() == size < grown, "undo of Assign"
    print("undo of Assign: ok", flush=True)


def check_undo_while_training():
    from cloak.blender import colors
    from cloak.session import session
    from cloak.training import run_list

    settings = bpy.context.scene.cloak
    settings.output, settings.steps, settings.live_seconds = FOLDER, 500, 0.5
    bpy.context.view_layer.objects.active = body()
    assign_all()
    press(bpy.ops.cloak.train_start)
    run = body().cloak.run
    while not colors.is_dressed(body()):
        assert session.job.running, session.job.message
        yield 0.2
    undo()
    assert not colors.is_dressed(body()) and body().cloak.run == run, "undo must not forget the run"
    while not colors.is_dressed(body()):
        assert session.job.running, session.job.message
        yield 0.2
    press(bpy.ops.cloak.train_cancel)
    while session.job.running:
        yield 0.2
    assert session.job.state == "stopped", session.job.message
    run_list.refresh(bpy.context)
    assert run_list.selected(bpy.context).state == "stopped"
    print("undo while it trains: run kept, body dressed again: ok", flush=True)


def check_training():
    from cloak.blender import colors

    settings = bpy.context.scene.cloak
    settings.output, settings.steps, settings.live_seconds = FOLDER, 12, 0.5
    bpy.context.view_layer.objects.active = body()
    press(bpy.ops.cloak.train_start)
    yield from until_done()
    assert colors.is_dressed(body())
    assign_all()
    undo()
    assert colors.is_dressed(body()), "undoing the next step must not take the colours along"
    print("trained colours keep their own undo step: ok", flush=True)


def check_edit_mode():
    from cloak.logo import overlay
    from made import set_mode

    size = logo_size()
    press(bpy.ops.cloak.result_toggle)
    bpy.context.view_layer.objects.active = body()
    with window():
        set_mode("EDIT")
        assign_all()
        area = next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == "VIEW_3D")
        with bpy.context.temp_override(area=area, region=next(r for r in area.regions if r.type == "WINDOW")):
            bpy.ops.mesh.select_all(action="SELECT")
            bpy.ops.view3d.view_axis(type="FRONT")
            bpy.ops.view3d.view_selected()
            bpy.ops.mesh.select_all(action="DESELECT")
    yield 3.0  # figures follow when the user rests
    while overlay.active_stats(body()) is None:  # counted after the first redraw
        yield 0.2
    assert overlay.active_stats(body()).faces > 1.5 * size
    Path(os.environ["SHOT_READY"]).touch()
    yield 3.0
    with window():
        set_mode("OBJECT")


def close_while_training():

    from cloak.session import session

    bpy.context.scene.cloak.steps = 500
    press(bpy.ops.cloak.train_start)
    while session.job.progress.step < 2:
        yield 0.2
    print("closing with process", session.job._process.pid, "in", body().cloak.run, flush=True)


def steps():
    install(ZIP, PYTHON)
    subprocess.run(["xdotool", "key", "Escape"], check=True)  # the splash screen
    make_body()
    yield 0.5
    for part in (check_undo, check_undo_while_training, check_training, check_edit_mode, close_while_training):
        yield from part()
        yield 0.5


play(steps())
