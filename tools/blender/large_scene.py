"""What a redraw of the panels and the overlay takes in a scene of ten thousand objects, in Blender's window.

    window.sh OUT.png tools/blender/large_scene.py ZIP [OBJECTS]

Milliseconds of processor time of the drawing thread, median and worst of the redraws: a body with a logo is active, one
without, or an object that is no body; and nothing changes, an object moves, or one is selected before each redraw.
"""

import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import install, play, show_tab, tidy, view_area

ZIP, *REST = sys.argv[sys.argv.index("--") + 1 :]
OBJECTS, REDRAWS = int(REST[0]) if REST else 10_000, 12
spent = [0.0]


@contextmanager
def timed():
    """Adds up what a block takes."""
    start = time.thread_time()
    try:
        yield
    finally:
        spent[0] += time.thread_time() - start


def time_panel(cls: type) -> None:
    """Let a panel add up what its drawing takes; Blender counts the arguments of `draw`."""
    draw = cls.draw

    def measured(self: bpy.types.Panel, context: bpy.types.Context) -> None:
        with timed():
            draw(self, context)

    cls.draw = measured


def time_reasons(base: type) -> None:
    """Let operators add up what it takes to know whether they can run, which every button asks."""
    poll = base.poll.__func__

    def measured(cls: type, context: bpy.types.Context) -> bool:
        with timed():
            return poll(cls, context)

    base.poll = classmethod(measured)


def draw_overlay() -> None:
    with timed():
        overlay._draw()


def redraws(before: Callable[[], None], figures: list[float]):
    """Steps: redraw the view and its sidebar, and note what ours took of it."""
    for _ in range(REDRAWS):
        before()
        spent[0] = 0.0
        view_area().tag_redraw()
        yield 0.15
        figures.append(1000 * spent[0])


def steps():
    global overlay
    install(ZIP, "host-python")
    import cloak
    import cloak.logo.overlay as overlay
    from cloak.blender import faces
    from cloak.ui.bases import CloakOperator
    from made import make_egg, make_fine_egg

    tidy()
    shirt = make_egg(16, 1.1, "Shirt")
    shirt.scale, shirt.location.z = (1.2, 1.2, 1), 0.35
    body = make_fine_egg(13_486, "Body")
    shirt.parent = body
    faces.new_logo(body, "chest", np.arange(len(body.data.polygons)) % 7 == 0)
    cube = bpy.data.meshes.new("Cube")
    cube.from_pydata(
        [(0, 0, 0), (0.3, 0, 0), (0, 0.3, 0), (0, 0, 0.3)], [], [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
    )
    for number in range(OBJECTS):
        other = bpy.data.objects.new(f"Cube {number}", cube)
        other.location = (2 + number % 100, 2 + number // 100, 0)
        bpy.context.scene.collection.objects.link(other)
    bpy.context.view_layer.objects.active = body
    for cls in cloak.CLASSES:
        if issubclass(cls, bpy.types.Panel):
            time_panel(cls)
    time_reasons(CloakOperator)
    overlay.HOOKS.unregister()
    overlay.HOOKS._drawing = ((draw_overlay, "POST_VIEW"),)
    overlay.HOOKS.register()
    stand = bpy.data.objects.new("Stand", None)
    bpy.context.scene.collection.objects.link(stand)
    bare = make_fine_egg(13_486, "Bare")
    bare.location.x = -3
    yield from show_tab()
    result = {}
    for active in (body, bare, stand):
        bpy.context.view_layer.objects.active = active
        for name, before in (
            ("nothing changes", lambda: None),
            ("an object moves", lambda: setattr(other, "location", (1, other.location[1] + 0.1, 0))),
            ("an object is selected", lambda: other.select_set(not other.select_get())),
        ):
            figures: list[float] = []
            yield from redraws(before, figures)
            figures = figures[2:]
            numbers = {"median": round(statistics.median(figures), 2), "worst": round(max(figures), 2)}
            result[f"{active.name} is active, {name}"] = numbers
    print(json.dumps({"objects": OBJECTS, "blender": bpy.app.version_string, "ms": result}), flush=True)
    Path(os.environ["SHOT_READY"]).touch()
    yield 3.0


play(steps())
