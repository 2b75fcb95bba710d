"""Opens the panels that judge a cloak, in a real Blender window, for a screenshot.

    window.sh OUT.png tools/blender/show_judging.py ZIP STATE PYTHON RUN

STATE is ring (the evaluation, with its ring around the body), eye (the detector's eye), heat (the heat map with the
logo's outline) or along (what is taken along: a turntable is made). PYTHON has cloak_core; RUN is a finished run on
sample:train (`zoo:NAME` copied, say), which is evaluated where it was not. Any error ends Blender with exit code 3.
"""

import os
import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import frame, install, open_panel, override, play, show_all, sidebar, tidy, until_done

ZIP, STATE, PYTHON, RUN = sys.argv[sys.argv.index("--") + 1 :][:4]
PANELS = {
    "ring": ("result", "evaluation"),
    "eye": ("result", "eye"),
    "heat": ("logo", "heatmap"),
    "along": ("result", "take_along"),
}


def look_from(turn: float, up: float, away: float = 1.0):
    """Turn the view around the body, radians, and step back from it; one after the other, for the view glides there."""
    for angle, way in ((turn, "ORBITRIGHT"), (up, "ORBITUP")):
        with override():
            bpy.ops.view3d.view_orbit(angle=angle, type=way)
        yield 1.0
    with override():
        region = bpy.context.space_data.region_3d
        region.view_perspective, region.view_distance = "PERSP", away * region.view_distance
    yield 0.5


def ring(obj):
    from cloak.training import run_list

    run_list.refresh(bpy.context)
    if run_list.selected(bpy.context).evaluation is None:
        judging = bpy.context.scene.cloak.judging
        judging.images, judging.angle = 96, 30
        bpy.ops.cloak.evaluate()
        yield from until_done()
    yield from look_from(0.25, 0.3, 1.5)


def eye(obj):
    from cloak.session import session

    yield from look_from(0.1, 0.0, 1.3)
    bpy.ops.cloak.eye()
    while session.eye.seen is None:
        yield 0.2
        assert session.eye is not None, session.job.message
    first = session.eye.seen.viewpoint
    yield from look_from(0.25, 0.1)
    while session.eye.seen.viewpoint == first or session.eye.waiting:  # it looks again
        yield 0.2
        assert session.eye is not None, session.job.message
    assert "cloak" in {sight.kind for sight in session.eye.seen.sights}


def heat(obj):
    settings = bpy.context.scene.cloak
    settings.angle_first = settings.angle_last = 0
    settings.pose_source = "CURRENT"
    bpy.ops.cloak.result_toggle()
    bpy.ops.cloak.heatmap()
    yield from until_done()


def along(obj):
    bpy.context.scene.cloak.judging.film_seconds = 1.0
    for press in (bpy.ops.cloak.print_sheets, bpy.ops.cloak.turntable):
        press()
        yield from until_done()
    from cloak.result import outputs

    assert {path.name for path in outputs.made(Path(RUN))} >= {"print sheets", "turntable.gif"}


def steps():
    """Run the steps in order; each yields the seconds that Blender may draw before the next."""
    install(ZIP, PYTHON)
    tidy()
    yield 0.5
    bpy.ops.cloak.add_sample_body()
    yield from until_done()
    frame()
    yield 0.5
    obj = bpy.context.view_layer.objects.active
    obj.cloak.run = RUN
    bpy.ops.cloak.result_load()
    bpy.ops.cloak.use_standard_view()
    yield from globals()[STATE](obj)
    for name in PANELS[STATE][1:]:
        open_panel(name)
    yield from sidebar(*PANELS[STATE])
    yield 2.0
    Path(os.environ["SHOT_READY"]).touch()
    yield 4.0
    show_all()


play(steps())
