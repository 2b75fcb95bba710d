"""Measures the add-on's figures on 55,000 faces, in a real Blender window or under the bpy package.

    window.sh tools/blender/measure.py ZIP        (with the window's redraw)
    python tools/blender/measure.py -- ZIP                                 (a Python with bpy)

Prints one JSON object; medians and maxima of REPEATS, in milliseconds.
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import install, print_figures

ZIP = sys.argv[sys.argv.index("--") + 1]
REPEATS, FACES, POSES = 9, 55_000, 12


def timed(call) -> tuple[float, float]:
    """Milliseconds by the clock, and of this thread's own work: they differ on a busy machine."""
    start, work = time.perf_counter(), time.thread_time()
    call()
    return 1000 * (time.perf_counter() - start), 1000 * (time.thread_time() - work)


def summary(values: list[tuple[float, float]]) -> dict:
    wall, work = zip(*values, strict=True)
    return {
        "median_ms": round(statistics.median(wall), 1),
        "max_ms": round(max(wall), 1),
        "max_own_work_ms": round(max(work), 1),
    }


def rigged_grid() -> bpy.types.Object:
    """55,000 triangles bent by an armature and two shape keys, as a character is."""
    from made import make_grid, set_mode

    obj = make_grid(FACES)
    obj.shape_key_add(name="Basis")
    for name in ("a", "b"):
        key = obj.shape_key_add(name=name)
        key.data.foreach_set("co", np.random.default_rng(0).random(3 * len(obj.data.vertices)).astype(np.float32))
        key.value = 0.1
    armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    set_mode("EDIT")
    bone = armature.data.edit_bones.new("spine")
    bone.tail = (0, 0, 1)
    set_mode("OBJECT")
    obj.vertex_groups.new(name="spine").add(range(len(obj.data.vertices)), 1.0, "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = armature
    for frame in (1, POSES):
        armature.pose.bones["spine"].rotation_mode = "XYZ"
        armature.pose.bones["spine"].rotation_euler.x = frame / 20
        armature.pose.bones["spine"].keyframe_insert("rotation_euler", frame=frame)
    bpy.context.view_layer.objects.active = obj
    return obj


def measure() -> dict:
    install(ZIP)
    from made import select_only, set_mode

    obj = rigged_grid()
    count = len(obj.data.polygons)
    ids = np.arange(0, count, 2)
    folder = Path(tempfile.mkdtemp())
    figures: dict = {"blender": bpy.app.version_string, "background": bpy.app.background, "faces": count}
    select_only(obj, ids)
    bpy.ops.cloak.logo_new(name="half")
    paths = [folder / f"{i}.npy" for i in range(REPEATS)]
    figures["export_face_list_from_edit_mode"] = summary(
        [timed(lambda p=p: bpy.ops.cloak.logo_export(filepath=str(p))) for p in paths]
    )
    set_mode("OBJECT")
    figures["export_12_poses"] = summary([timed(lambda i=i: export(obj, folder / f"input {i}")) for i in range(5)])
    return figures | measure_colors(obj, ids, folder / "run")


def export(obj: bpy.types.Object, folder: Path) -> None:
    from cloak.poses import export as scene_export
    from cloak.poses import poses

    scene_export.export(bpy.context, obj, "half", poses.PoseChoice("RANGE", 1, POSES, 1), folder)


def measure_colors(obj: bpy.types.Object, ids: np.ndarray, run: Path) -> dict:
    """A run's colours onto the object: at once, and live."""
    from cloak.blender import colors
    from cloak.blender.mesh_arrays import topology
    from cloak.exchange.face_lists import write_colors, write_face_list
    from cloak.training import runs

    run.mkdir()
    write_face_list(run / "logo.npy", ids, topology(obj))
    rng = np.random.default_rng(0)

    def timed_with_new_colors(call) -> tuple[float, float]:
        write_colors(run / "colors.npy", rng.random((len(ids), 3)))
        return timed(call)

    imports = [timed_with_new_colors(lambda: runs.import_colors(bpy.context, obj, run)) for _ in range(REPEATS)]
    figures = {"import_colors": summary(imports)}
    colors.undress(obj)
    obj.data.attributes.remove(obj.data.attributes["cloak.colors"])
    live = runs.LiveColors(obj, run)

    def update(show) -> tuple[float, float]:
        return timed_with_new_colors(lambda: live.update(bpy.context) and show())

    values = [update(bpy.context.view_layer.update) for _ in range(REPEATS + 1)]
    figures["first_live_update"] = round(values[0][0], 1)
    figures["live_update"] = summary(values[1:])
    if not bpy.app.background:
        figures["live_update_with_redraw"] = summary([update(redraw) for _ in range(REPEATS)])
        figures["redraw_alone"] = summary([timed(redraw) for _ in range(REPEATS)])
    return figures


def redraw() -> None:
    bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=1)


print_figures(measure)
