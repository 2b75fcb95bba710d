"""The first look: a new file with its cube, the sample body added beside it, and the panel as a newcomer finds it.

    window.sh OUT.png tools/blender/show_first_look.py ZIP PYTHON [de|fr]

The window is as large as the screen of the machine that draws it; in 1600 x 1000, Start must stand above the fold.
"""

import os
import subprocess
import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import install, play, show_tab, until_done, view_area

WORDS = sys.argv[sys.argv.index("--") + 1 :]
ZIP, PYTHON, LANGUAGE = WORDS[0], WORDS[1], "".join(WORDS[2:])
SHOWN = {"de": "Mit Pinsel malen", "fr": "Peindre à la brosse"}


def speak(language):
    """Blender's whole window in another language; its names for languages differ between versions."""
    view = bpy.context.preferences.view
    view.language = next(name for name in bpy.app.translations.locales if name.split("_")[0] == language)
    view.use_translate_interface = view.use_translate_tooltips = True
    for context in ("*", "Operator"):
        assert bpy.app.translations.pgettext("Paint with a Brush", context) == SHOWN[language]


def steps():
    install(ZIP, PYTHON)
    if LANGUAGE:
        speak(LANGUAGE)
    bpy.ops.mesh.primitive_cube_add(size=2)
    cube = bpy.context.object  # named in the language of the window
    subprocess.run(["xdotool", "key", "Escape"], check=True)  # the splash screen
    view_area().spaces.active.show_region_ui = True
    yield 0.5
    bpy.ops.cloak.add_sample_body()
    yield from until_done()
    body = bpy.data.objects["Sample Body"]
    assert bpy.context.object == body and body.location.x - cube.location.x > 1, "it must not stand in the cube"
    yield from show_tab()
    yield 4.0
    Path(os.environ["SHOT_READY"]).touch()
    yield 4.0


play(steps())
