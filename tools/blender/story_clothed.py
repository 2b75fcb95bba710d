"""From an own clothed body to a worn cloak and a verdict, click by click, with a picture of the window after each.

    window.sh tools/blender/story_clothed.py ZIP PYTHON FOLDER [LANGUAGE] [DETECTOR ...]

PYTHON has cloak_core; pictures go to FOLDER/NN name.png; DETECTORS are files that are added through the browser's
operator. Every step that a user would click is counted and printed; an error ends Blender with exit code 3.
"""

import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import frame, install, open_panel, play, show_tab, tidy

ZIP, PYTHON, FOLDER, *REST = sys.argv[sys.argv.index("--") + 1 :]
LANGUAGE, DETECTORS = (REST or ["en_US"])[0], REST[1:]
clicks = []


def picture(name: str):
    """Draw, then photograph the screen."""
    for _ in range(2):
        for area in bpy.context.window_manager.windows[0].screen.areas:
            area.tag_redraw()
        yield 0.8
    place = Path(FOLDER, f"{len(clicks):02d} {name}.png")
    subprocess.run(["import", "-window", "root", str(place)], check=True)


def click(name: str, operator, **arguments):
    """What a button does; greyed ones fail here."""
    clicks.append(name)
    operator(**arguments)
    print(len(clicks), name, flush=True)
    yield from picture(name)


def scroll(down: int):
    """Turn the mouse wheel over the sidebar."""
    subprocess.run(["xdotool", "mousemove", "1330", "400"], check=True)
    button = "5" if down > 0 else "4"
    subprocess.run(["xdotool", "click", "--repeat", str(abs(down)), "--delay", "40", button], check=True)
    yield 0.6


def until_done():
    from cloak.session import session

    while session.job is not None and session.job.active:
        yield 0.3
    print("   ", session.job.message if session.job else "", flush=True)


def steps():
    from made import centers, make_egg

    install(ZIP, PYTHON)
    from cloak.blender import colors, faces

    view = bpy.context.preferences.view
    view.language = LANGUAGE
    view.use_translate_interface = view.use_translate_tooltips = True
    open_panel("evaluation")  # before it is first drawn closed
    tidy()
    obj = make_egg(60, name="Mina")
    shirt = make_egg(40, 1.1, "Shirt")
    shirt.scale, shirt.location.z, shirt.parent = (1.15, 1.15, 1), 0.4, obj
    stone = make_egg(8, 0.4, "Stone")
    stone.location = (1.2, 0, 0)
    obj.select_set(True)
    shirt.select_set(False)
    stone.select_set(False)
    bpy.context.view_layer.objects.active = obj
    for thing, color in ((obj, (0.8, 0.55, 0.4, 1)), (shirt, (0.15, 0.25, 0.6, 1))):
        material = bpy.data.materials.new(thing.name)
        shader = next(n for n in colors.nodes_of(material)[0] if n.type == "BSDF_PRINCIPLED")  # its name is translated
        shader.inputs["Base Color"].default_value = color
        thing.data.materials.append(material)
    frame()
    places = centers(obj)
    settings = bpy.context.scene.cloak
    settings.output, settings.steps, settings.frame_end = str(Path(FOLDER, "runs")), 40, 1
    settings.angle_first, settings.angle_last, settings.angle_step = -10, 10, 10
    obj.cloak.logo = faces.new_logo(obj, "chest", (places[:, 1] < -0.1) & (np.abs(places[:, 2] - 0.95) < 0.25))
    yield from show_tab()
    yield 1.5
    yield from picture("the body with its logo")
    cloak = bpy.ops.cloak
    yield from click("put the logo on the shirt", cloak.logo_onto, garment="Shirt")
    yield from scroll(40)
    for path in DETECTORS:
        yield from click(
            f"add {Path(path).name}",
            cloak.detector_add,
            directory=str(Path(path).parent),
            files=[{"name": Path(path).name}],
        )
    yield from until_done()
    yield from picture("detectors")
    yield from click("start", cloak.train_start)
    yield from until_done()
    yield from picture("trained")
    yield from click("render check", cloak.render_check)
    yield from until_done()
    yield from scroll(60)
    yield from picture("verdict")
    settings.judging.images = 24
    settings.judging.angle = 45
    yield from click("evaluate", cloak.evaluate)
    yield from until_done()
    yield from scroll(60)
    yield from picture("evaluated")
    print(len(clicks), "clicks", flush=True)


play(steps())
