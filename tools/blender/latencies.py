"""Measures what a user waits for while picking a logo in Edit Mode, in a real Blender or under the bpy package.

    python tools/blender/latencies.py -- ZIP SCENE [FACES ...]                       (a Python with bpy)
    window.sh tools/blender/latencies.py ZIP SCENE [FACES ...]      (with the window)

SCENE is a scene package whose poses become shape keys (`cloak scene sample --out SCENE`); FACES are the sizes of the
other bodies, 55,000 and 300,000 where none is given. Prints one JSON object of milliseconds: the median of REPEATS by
the clock, and in brackets what all of Blender's threads worked, which is the larger of the two on an idle machine and
the one that can be compared on a busy one. "subdivide", and what is done in Object Mode, is done once.
"""

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import install, print_figures

WORDS = sys.argv[sys.argv.index("--") + 1 :]
ZIP, SCENE, SIZES = WORDS[0], WORDS[1], [int(word) for word in WORDS[2:]] or [55_000, 300_000]
REPEATS = 5


def milliseconds(call: Callable) -> tuple[float, float]:
    start, work = time.perf_counter(), time.process_time()
    call()
    return 1000 * (time.perf_counter() - start), 1000 * (time.process_time() - work)


def summary(values: list[tuple[float, float]]) -> str:
    wall, work = map(statistics.median, zip(*values, strict=True))
    return f"{wall:.0f} ({work:.0f})"


def sample() -> bpy.types.Object:
    from cloak.body import objects
    from cloak.exchange.scenes import read_scene

    return objects.add_from_scene(bpy.context, read_scene(Path(SCENE)))


def touch(obj: bpy.types.Object) -> None:
    """What follows a change of the mesh in Edit Mode, before anything is measured."""
    import bmesh

    bmesh.update_edit_mesh(obj.data, loop_triangles=False, destructive=False)
    bpy.context.view_layer.update()


def waits(obj: bpy.types.Object) -> dict[str, str]:
    """Every wait in Edit Mode, on one body."""
    from cloak.blender import faces
    from cloak.blender.evaluated import read_surface
    from cloak.blender.mesh_arrays import current_mesh
    from cloak.logo import overlay
    from cloak.logo.stamp import Placed, laid, text_stamp
    from made import select_only, set_mode, stroke

    print(obj.name, file=sys.stderr, flush=True)
    bpy.context.view_layer.objects.active = obj
    count = len(obj.data.polygons)
    select_only(obj, range(count // 3, count // 2))
    bpy.ops.cloak.logo_new(name="logo")
    folder = Path(tempfile.mkdtemp())
    numbers, kept = iter(range(10**6)), {}

    def stamped() -> None:
        bpy.ops.cloak.logo_stamp(add=True)

    def tinted() -> None:
        with current_mesh(obj):  # as the overlay does
            overlay.tint_triangles(obj, faces.read_faces(obj, "logo"))

    def dabbed() -> None:
        painted = kept["surface"].hits(np.array([0.05, -9, 1]), np.array([0, 1, 0]))
        kept["surface"].around(painted[0], 0.1)

    def dragged() -> None:
        """A perspective view: each move looks from elsewhere."""
        x = 0.01 * next(numbers)
        kept["placed"].faces(laid(np.array([0, -0.25, 1]), np.array([x, 1, 0]), 0.5, kept["placed"].aspect))

    def exported() -> None:
        bpy.ops.cloak.logo_export(filepath=str(folder / f"{next(numbers)}.npy"))

    def imported() -> None:
        bpy.ops.cloak.logo_import(filepath=str(max(folder.glob("*.npy"))))

    def picked(kind: str, **choice: str) -> Callable:
        return lambda: getattr(bpy.ops.cloak, f"logo_from_{kind}")(add=True, **choice)

    def painted() -> None:
        place = kept["surface"].hits(np.array([0.05, -9, 1]), np.array([0, 1, 0]))[0]
        dabs = stroke(*((place + np.array([0.005 * i, 0, 0]), 0.05) for i in range(20)))
        bpy.ops.cloak.logo_paint(stroke=dabs)

    def dropped() -> None:
        bpy.ops.cloak.stamp_drag(place=(0, -0.25, 1), direction=(0, 1, 0), height=0.5, add=True)

    set_mode("OBJECT")
    obj.data.materials.append(bpy.data.materials.new("skin"))
    obj.data.attributes.new(".sculpt_face_set", "INT", "FACE")
    select_only(obj, range(count // 3, count // 2))

    actions = {
        "stamp": stamped,
        "brush: begin": lambda: kept.update(surface=read_surface(bpy.context, obj)),
        "brush: dab": dabbed,
        "drag: begin": lambda: kept.update(placed=Placed(read_surface(bpy.context, obj), text_stamp("G"))),
        "drag: move": dragged,
        "figures": lambda: overlay.active_stats(obj),
        "tint": tinted,
        "assign": bpy.ops.cloak.logo_assign,
        "select": bpy.ops.cloak.logo_select,
        "remove": bpy.ops.cloak.logo_unassign,
        "paint: 20 dabs": painted,
        "drag: drop": dropped,
        "from material": picked("material", slot="0"),
        "from face set": picked("face_set", face_set="0 .sculpt_face_set"),
        "export": exported,
        "new": bpy.ops.cloak.logo_new,
        "import": imported,
        "delete": bpy.ops.cloak.logo_remove,
    }
    figures = {}
    for name, action in actions.items():
        values = []
        for _ in range(REPEATS):
            touch(obj)
            values.append(milliseconds(action))
        figures[name] = summary(values)
    figures["subdivide"] = summary([milliseconds(bpy.ops.cloak.subdivide)])
    set_mode("OBJECT")
    return figures


def results(obj: bpy.types.Object) -> dict[str, str]:
    """What follows a training or a heat map, and clothing, in Object Mode, on one body."""
    from cloak.blender import faces
    from cloak.blender.mesh_arrays import topology
    from cloak.exchange.face_lists import write_colors, write_face_list
    from cloak.logo.operators import show_heat
    from made import make_fine_egg

    count = len(obj.data.polygons)
    garment = make_fine_egg(count, "Garment")
    garment.scale, garment.parent = (1.05, 1.05, 1), obj
    bpy.context.view_layer.objects.active = obj
    obj.cloak.logo = faces.new_logo(obj, "front", np.arange(count) < count // 5)
    ids, run = np.arange(count // 5), Path(tempfile.mkdtemp())
    write_face_list(run / "logo.npy", ids, topology(obj))
    write_colors(run / "colors.npy", np.full((len(ids), 3), 0.3, np.float32))
    obj.cloak.run = str(run)
    actions = {
        "load colours": bpy.ops.cloak.result_load,
        "show original": bpy.ops.cloak.result_toggle,
        "show cloak": bpy.ops.cloak.result_toggle,
        "bake": lambda: bpy.ops.cloak.bake(size=2048),
        "show heat": lambda: show_heat(obj, np.linspace(0, 1, count, dtype=np.float32)),
        "hide heat": bpy.ops.cloak.heatmap_toggle,
        "new from heat": bpy.ops.cloak.logo_from_heat,
        "put the logo on a garment": lambda: bpy.ops.cloak.logo_onto(garment="Garment"),
    }
    figures = {}
    for name, action in actions.items():
        bpy.context.view_layer.update()
        figures[name] = summary([milliseconds(action)])
    bpy.data.objects.remove(garment)
    return figures


def measure() -> dict:
    install(ZIP)
    bpy.context.scene.cloak.stamp_size = 0.4
    figures: dict = {"blender": bpy.app.version_string, "background": bpy.app.background}
    from made import make_fine_egg

    for make in (sample, *(lambda size=size: make_fine_egg(size) for size in SIZES)):
        obj = make()
        keys = len(obj.data.shape_keys.key_blocks) if obj.data.shape_keys else 0
        name = f"{len(obj.data.polygons):,} faces, {keys} shape keys"
        figures[name] = results(obj) | waits(obj)
        bpy.data.objects.remove(obj)
    return figures


print_figures(measure)
