"""From the file of a clothed body of one's own to a verdict, with a mouse that clicks on words, and a picture of each.

    window.sh tools/blender/story_clothed.py ZIP PYTHON OUT BODY.glb [STEPS]

PYTHON has cloak_core. BODY.glb has the body and its clothes as objects of their own. Without STEPS it trains as long as
the panel says. OUT gets NN-NAME.jpg for each click, the verdict, and `story.json`: clicks, seconds, verdict. More than
CLICKS clicks and keys end Blender with exit code 3, as does the first word that cannot be found.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import frame, install, play
from mouse import Mouse, busy_with, in_sidebar, region, xdo
from words import places, screen

ZIP, PYTHON, OUT, BODY, *REST = sys.argv[sys.argv.index("--") + 1 :]
CLICKS = 9
mouse = Mouse(Path(OUT), CLICKS)


def browsers() -> list[bpy.types.Space]:
    """The file browsers that are open."""
    areas = [area for window in bpy.context.window_manager.windows for area in window.screen.areas]
    return [area.spaces.active for area in areas if area.type == "FILE_BROWSER" and area.spaces.active.params]


def import_body() -> Iterator[float]:
    meshes = len(bpy.data.meshes)
    item = "glTF 2.0 (.glb/.gltf)"
    yield from mouse.click("File", "file", lambda: places("Import", screen()), anywhere=True)
    yield from mouse.point("Import", lambda words: places(words, screen()))  # the menu opens under the mouse
    yield from mouse.click(item, "gltf", browsers, anywhere=True)
    browsers()[0].params.directory = str(Path(BODY).parent).encode()  # as Blender remembers the last one
    imported = lambda: len(bpy.data.meshes) > meshes + 1 and not browsers()
    yield from mouse.click(Path(BODY).name, "import", imported, anywhere=True, times=2)
    frame()  # for the pictures


def make_logo() -> Iterator[float]:
    from cloak.blender.faces import logo_names

    mouse.press("n")
    yield from mouse.until(lambda: region("UI").width > 1, "N opens the sidebar")
    yield from mouse.click("Cloak", "tab", lambda: region("UI").active_panel_category == "Cloak", turned=True)
    yield from mouse.until(lambda: in_sidebar("Trainer found"), "the trainer is found")
    body = bpy.context.object
    yield from mouse.click("Stamp New Logo", "stamp", lambda: logo_names(body.data))
    clothes = [o for o in bpy.data.objects if o.type == "MESH" and o != body]
    yield from mouse.click("Put the Logo on It", "clothes", lambda: any(logo_names(o.data) for o in clothes))


def judge() -> Iterator[float]:
    from cloak.session import session

    if REST:
        bpy.context.scene.cloak.steps = int(REST[0])
    yield from mouse.click("Start", "start", busy_with("Training"))
    yield from mouse.finished("training", lambda: mouse.photograph("training"))
    yield from mouse.click("Render Check", "check", busy_with("Render check"))
    yield from mouse.finished("render check")
    yield from mouse.until(lambda: mouse.scroll_to("With the cloak"), "the renders are shown")
    mouse.photograph("verdict")
    told = {"clicks": mouse.clicks, "seconds": mouse.seconds, "verdict": session.job.message}
    Path(OUT, "story.json").write_text(json.dumps({"blender": bpy.app.version_string, **told}, indent=1))


def steps() -> Iterator[float]:
    install(ZIP, PYTHON)
    bpy.context.preferences.view.filebrowser_display_type = "SCREEN"  # without a window manager windows have no focus
    xdo("key", "Escape")  # the splash screen
    bpy.context.scene.cloak.output = str(Path(OUT, "runs"))
    yield 2.0
    yield from import_body()
    yield from make_logo()
    yield from judge()


play(steps())
