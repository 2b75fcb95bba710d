"""A newcomer: from a new file to a cloaked turntable, with a mouse that clicks on words, and a picture of each click.

    window.sh tools/blender/show_newcomer.py ZIP PYTHON OUT [STEPS]

The extension is installed and PYTHON has cloak_core; all else is as Blender and the panel begin with (of STEPS other
than the panel's own the words tell). A click goes where the words stand on the screen, so what is clipped, covered or
missing ends Blender with exit code 3; so do more than CLICKS clicks and keys. OUT gets NN-NAME.jpg for each click, just
before it and with a ring around it, turntable.gif, its figures and a strip of its frames, demo.blend, and
newcomer.json: clicks, seconds by the clock, seconds of processor that the trainer took.
"""

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import install, play
from mouse import WIDTH, Mouse, busy_with, in_sidebar, region, xdo

WORDS = sys.argv[sys.argv.index("--") + 1 :]
ZIP, PYTHON, OUT, STEPS = WORDS[0], WORDS[1], Path(WORDS[2]), int(WORDS[3]) if len(WORDS) > 3 else 0
CLICKS = 12
begun, mouse = time.monotonic(), Mouse(OUT, CLICKS)


def get_a_body() -> Iterator[float]:
    mouse.press("n")
    yield from mouse.until(lambda: region("UI").width > 1, "N opens the sidebar")
    yield from mouse.click("Cloak", "tab", lambda: region("UI").active_panel_category == "Cloak", turned=True)
    yield from mouse.until(lambda: in_sidebar("Trainer found"), "the trainer is found")
    yield from mouse.click("Clothed", "body", busy_with("Sample body"))
    yield from mouse.finished("sample body")
    assert bpy.context.object.name == "Sample Body" and bpy.context.object.cloak.logo == "clothes"


def train() -> Iterator[float]:
    if STEPS:
        bpy.context.scene.cloak.steps = STEPS
    yield from mouse.click("Start", "start", busy_with("Training"))
    yield from mouse.finished("training", lambda: mouse.photograph("training"))


def take_along() -> Iterator[float]:
    scene = bpy.context.scene
    yield from mouse.click("Use Standard", "standard", lambda: scene.view_settings.view_transform == "Standard")
    yield from mouse.click("Print, Film, Image", "take_along", lambda: True)
    yield from mouse.click("Turntable", "turntable", busy_with("Turntable"))
    yield from mouse.finished("turntable")
    yield from mouse.until(lambda: mouse.scroll_to("turntable.gif"), "the turntable is listed")


def strip(film: Path) -> None:
    """Four frames of a film, a quarter of its time apart."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["convert", str(film), "-coalesce", f"{folder}/%04d.png"], check=True)
        frames = sorted(map(str, Path(folder).iterdir()))
        four = [frames[quarter * len(frames) // 4] for quarter in range(4)]
        number = len(list(OUT.glob("*.jpg"))) + 1
        options = ["+append", "-resize", str(WIDTH), "-quality", "82", str(OUT / f"{number:02}-strip.jpg")]
        subprocess.run(["convert", *four, *options], check=True)


def keep() -> None:
    from cloak.session import session
    from cloak.training import run_list

    run = Path(bpy.path.abspath(bpy.context.object.cloak.run))
    film = next(run.parent.glob(f"{run.name}*/turntable.gif"))
    for file in (film, film.with_suffix(".json")):
        shutil.copy(file, OUT)
    strip(OUT / "turntable.gif")
    state = run_list.read_state(run)
    told = {
        "blender": bpy.app.version_string,
        "clicks": mouse.clicks,
        "steps": bpy.context.scene.cloak.steps,
        "seconds": mouse.seconds,
    }
    told |= {"whole": round(time.monotonic() - begun, 1), "success_in_training": state.progress.success}
    (OUT / "newcomer.json").write_text(json.dumps(told, indent=1))
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT / "demo.blend"), compress=True)
    print(json.dumps(told), (OUT / "demo.blend").stat().st_size, session.job.message, flush=True)


def steps() -> Iterator[float]:
    global begun
    install(ZIP, PYTHON, empty=False)
    xdo("key", "Escape")  # the splash screen
    yield 2.0
    begun = time.monotonic()
    yield from get_a_body()
    yield from train()
    yield from take_along()
    keep()


play(steps())
