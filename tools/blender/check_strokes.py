"""A training ends while the artist is in the middle of a stroke: the colours come, and their step of undo, after it.

    window.sh tools/blender/check_strokes.py ZIP FOLDER [ROUNDS [KIND ...]]

In each round a training ends while the mouse of another object's stroke is down, or that object is grabbed. KIND is one
of STROKES. Ends Blender with exit code 3 at the first round in which the colours come too early or not at all, or in
which Ctrl Z takes half a stroke: it takes the colours in Object Mode, and in other modes the stroke.
"""

import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import install, override, play, tidy
from mouse import move, xdo

ZIP, FOLDER, *REST = sys.argv[sys.argv.index("--") + 1 :]
RUN, GO = Path(FOLDER, "run"), Path(FOLDER, "go")
"""A run folder, and the file that its training waits for."""
STROKES = {"sculpt": "SCULPT", "paint": "TEXTURE_PAINT", "vertex": "VERTEX_PAINT", "edit": "EDIT", "grab": "OBJECT"}
ROUNDS, KINDS = int(REST[0]) if REST else 100, REST[1:] or list(STROKES)


def body() -> bpy.types.Object:
    """Fetched again each time: undo replaces what Python holds."""
    return bpy.data.objects["Body"]


def clay() -> bpy.types.Object:
    return bpy.data.objects["Clay"]


def state() -> object:
    """What a stroke changes of the clay."""
    if clay().mode == "TEXTURE_PAINT":
        values = np.empty(4 * 256 * 256, np.float32)
        bpy.data.images["Canvas"].pixels.foreach_get(values)
        return float(values.sum())
    if clay().mode == "VERTEX_PAINT":
        values = np.empty(4 * len(clay().data.color_attributes[0].data), np.float32)
        clay().data.color_attributes[0].data.foreach_get("color", values)
        return float(values.sum())
    clay().update_from_editmode()
    values = np.empty(3 * len(clay().data.vertices), np.float32)
    clay().data.vertices.foreach_get("co", values)
    return float(values.sum()), tuple(clay().location)


def make_scene() -> None:
    from cloak.blender.mesh_arrays import topology
    from cloak.exchange.face_lists import write_colors, write_face_list
    from made import make_egg, make_fine_egg

    egg = make_egg()
    RUN.mkdir(parents=True)
    write_face_list(RUN / "logo.npy", np.array([10, 20, 333]), topology(egg))
    write_colors(RUN / "colors.npy", np.tile(np.float32([1, 0, 0]), (3, 1)))
    other = make_fine_egg(20_000, "Clay")
    other.location.x, egg.location.x = 0, 2
    corners = np.array([other.data.vertices[loop.vertex_index].co for loop in other.data.loops])
    layer = other.data.uv_layers.new(name="UVMap", do_init=False)
    layer.uv.foreach_set("vector", (corners[:, [0, 2]] / 1.8 + [0.5, 0]).astype(np.float32).ravel())
    other.data.color_attributes.new("Painted", "BYTE_COLOR", "CORNER")
    painting = bpy.context.scene.tool_settings.image_paint
    painting.mode, painting.canvas = "IMAGE", bpy.data.images.new("Canvas", 256, 256)
    painting.canvas.generated_color = (0.5, 0.5, 0.5, 1)  # the brush may be black or white
    egg.select_set(False)
    with override():
        bpy.ops.view3d.view_axis(type="FRONT")
        bpy.ops.view3d.view_selected()
        bpy.ops.ed.undo_push(message="Start")


def until(condition):
    """Steps until it holds, for at most five seconds."""
    for _ in range(50):
        if condition():
            return
        yield 0.1


def enter(mode: str) -> None:
    bpy.context.view_layer.objects.active = clay()
    with override():
        bpy.ops.object.mode_set(mode=mode)
        if mode == "EDIT":
            bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.ed.undo_push(message="Mode")  # as a key does, and a script does not


def end_training_in_stroke(kind: str):
    """One round."""
    from cloak.blender import colors
    from cloak.session import session
    from cloak.trainer.jobs import TrainingJob
    from cloak.training.operators import follow

    colors.undress(body())  # what a round before left
    enter(STROKES[kind])
    yield 0.3
    GO.unlink(missing_ok=True)
    wait = ["sh", "-c", 'until [ -e "$0" ]; do sleep 0.02; done', str(GO)]
    follow(body(), TrainingJob(wait, RUN, Path(FOLDER)))
    job, before = session.jobs[-1], state()
    yield from move(0.45, 0.45)
    xdo(*(("key", "g") if kind in ("edit", "grab") else ("mousedown", 1)))
    yield from move(0.5, 0.5, 4, (0.45, 0.45))
    GO.touch()
    yield from move(0.56, 0.55, 7, (0.5, 0.5))
    assert job.running, "the job's end did not wait for the stroke"
    xdo("click" if kind in ("edit", "grab") else "mouseup", 1)
    waits = kind in ("sculpt", "paint")
    yield from move(0.57, 0.55, 7) if waits else until(lambda: not job.running)
    assert job.running == waits, "colours come after a stroke, and when Sculpt Mode or Texture Paint has been left"
    yield from until(lambda: state() != before)  # the first stroke of a mode takes a busy machine seconds
    after = state()
    assert after != before, "the stroke did nothing"
    xdo("key", "ctrl+z")
    wanted = after if kind == "grab" else before
    yield from until(lambda: state() == wanted and (kind != "grab" or not colors.is_dressed(body())))
    assert state() == wanted, f"Ctrl Z takes something else than the {'colours' if kind == 'grab' else 'stroke'}"
    assert kind != "grab" or not colors.is_dressed(body()), "the colours have no step of undo"
    enter("OBJECT")
    yield from until(lambda: not job.running)
    assert job.state == "done", job.message
    assert colors.is_dressed(body()) or not waits


def steps():
    install(ZIP)
    tidy()
    yield 1.0
    make_scene()
    yield 1.0
    for kind in KINDS:
        for number in range(ROUNDS):
            yield from end_training_in_stroke(kind)
            print(kind, number + 1, flush=True)


play(steps())
