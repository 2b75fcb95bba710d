"""A newcomer: from a new file to a cloaked turntable, with a mouse that clicks on words, and a picture of each click.

    window.sh tools/blender/show_newcomer.py ZIP PYTHON OUT [STEPS]

The extension is installed and PYTHON has cloak_core; all else is as Blender and the panel begin with (of STEPS other
than the panel's own the words tell). A click goes where the words stand on the screen, so what is clipped, covered or
missing ends Blender with exit code 3; so do more than CLICKS clicks and keys. OUT gets NN-NAME.jpg for each click, just
before it and with a ring around it, turntable.gif, its figures and a strip of its frames, demo.blend, and
newcomer.json: clicks, seconds by the clock, seconds of processor that the trainer took.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import install, play, until_done, view_area
from words import places, screen

WORDS = sys.argv[sys.argv.index("--") + 1 :]
ZIP, PYTHON, OUT, STEPS = WORDS[0], WORDS[1], Path(WORDS[2]), int(WORDS[3]) if len(WORDS) > 3 else 0
CLICKS = 12
PATIENCE = 180
"""Seconds until words must be there, and a click must have had its effect; a busy machine draws slowly."""
WIDTH = 1200
"""Of the pictures."""

begun, clicks, seconds = time.monotonic(), [], {}
last_sidebar = np.zeros(0)


def xdo(*words: object) -> None:
    subprocess.run(["xdotool", *map(str, words)], check=True)


def region(kind: str):
    return next(r for r in view_area().regions if r.type == kind)


def middle_of(kind: str) -> tuple[int, int]:
    """Of a region of the viewport, in pixels of the screen."""
    found, window = region(kind), bpy.context.window_manager.windows[0]
    return found.x + found.width // 2, window.height - (found.y + found.height // 2)


def sidebar() -> tuple[np.ndarray, int, int]:
    """[h, w] what the sidebar shows, and its left and upper edge on the screen."""
    found, window = region("UI"), bpy.context.window_manager.windows[0]
    top = max(0, window.height - found.y - found.height)
    return screen()[top : window.height - found.y, found.x : found.x + found.width], found.x, top


def in_sidebar(text: str, turned: bool = False) -> list[tuple[int, int]]:
    """Where a text stands in the sidebar."""
    image, left, top = sidebar()
    return [(x + left, y + top) for x, y in places(text, image, turned)]


def until(condition: Callable[[], object], what: str, patience: float = PATIENCE) -> Iterator[float]:
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            photograph("failed")
            raise AssertionError(what)
        yield 0.2


def photograph(name: str, ring: tuple[int, int] | None = None) -> None:
    """The screen into OUT, with a ring around where the mouse clicks."""
    number = len(list(OUT.glob("*.jpg"))) + 1
    command = ["convert", "x:root"]
    if ring is not None:
        x, y = ring
        command += ["-fill", "none", "-stroke", "#ffb000", "-strokewidth", "4", "-draw", f"circle {x},{y} {x + 26},{y}"]
    command += ["-resize", str(WIDTH), "-quality", "82", str(OUT / f"{number:02}-{name}.jpg")]
    subprocess.run(command, check=True)


def scroll_to(text: str, turned: bool = False) -> list[tuple[int, int]]:
    """Where a text stands in the sidebar, once that stands still, as Blender scrolls smoothly; where there is none the
    sidebar is scrolled down a little."""
    global last_sidebar
    moving, last_sidebar = last_sidebar, sidebar()[0]
    if not np.array_equal(moving, last_sidebar):
        return []
    found = in_sidebar(text, turned)
    if not found:
        xdo("mousemove", *middle_of("UI"), *["click", 5] * 6)
    return found


def count(what: str) -> None:
    clicks.append(what)
    print(f"click {len(clicks)}: {what}", flush=True)
    assert len(clicks) <= CLICKS, f"more than {CLICKS} clicks"


def click(text: str, name: str, effect: Callable[[], object], turned: bool = False) -> Iterator[float]:
    """Find a text in the sidebar, scrolling down to it if need be; click on it and see that it had its effect."""
    found: list[tuple[int, int]] = []

    def is_found() -> bool:
        found[:] = scroll_to(text, turned)
        return bool(found)

    yield from until(is_found, f"'{text}' is not to be read in the sidebar")
    photograph(name, found[0])
    count(text)
    xdo("mousemove", *found[0])
    yield 0.5
    xdo("click", 1)
    yield 0.5  # Blender drags a panel whose header the mouse leaves at once
    yield from until(effect, f"'{text}' had no effect")


def finished(label: str, half_way: Callable[[], None] = lambda: None) -> Iterator[float]:
    """Wait for the job that a click started."""
    from cloak.session import session

    start, before = time.monotonic(), os.times()
    while session.job.running and session.job.fraction < 0.5:
        yield 0.5
    half_way()
    yield from until_done()
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    seconds[label] = {"clock": round(time.monotonic() - start, 1), "processor": round(spent, 1)}
    print(session.job.message, seconds[label], flush=True)


def busy_with(label: str) -> Callable[[], bool]:

    from cloak.session import session

    return lambda: session.job is not None and session.job.label == label


def get_a_body() -> Iterator[float]:
    xdo("mousemove", *middle_of("WINDOW"), "key", "n")
    count("N")
    yield from until(lambda: region("UI").width > 1, "N opens the sidebar")
    yield from click("Cloak", "tab", lambda: region("UI").active_panel_category == "Cloak", turned=True)
    yield from until(lambda: in_sidebar("Trainer found"), "the trainer is found")
    yield from click("Clothed", "body", busy_with("Sample body"))
    yield from finished("sample body")
    assert bpy.context.object.name == "Sample Body" and bpy.context.object.cloak.logo == "clothes"


def train() -> Iterator[float]:
    if STEPS:
        bpy.context.scene.cloak.steps = STEPS
    yield from click("Start", "start", busy_with("Training"))
    yield from finished("training", lambda: photograph("training"))


def take_along() -> Iterator[float]:
    scene = bpy.context.scene
    yield from click("Use Standard", "standard", lambda: scene.view_settings.view_transform == "Standard")
    yield from click("Print, Film, Image", "take_along", lambda: True)
    yield from click("Turntable", "turntable", busy_with("Turntable"))
    yield from finished("turntable")
    yield from until(lambda: scroll_to("turntable.gif"), "the turntable is listed")


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
    from cloak.training import run_states

    run = Path(bpy.path.abspath(bpy.context.object.cloak.run))
    film = next(run.parent.glob(f"{run.name}*/turntable.gif"))
    for file in (film, film.with_suffix(".json")):
        shutil.copy(file, OUT)
    strip(OUT / "turntable.gif")
    state = run_states.read_state(run)
    told = {
        "blender": bpy.app.version_string,
        "clicks": clicks,
        "steps": bpy.context.scene.cloak.steps,
        "seconds": seconds,
    }
    told |= {"whole": round(time.monotonic() - begun, 1), "success_in_training": state.progress.success}
    (OUT / "newcomer.json").write_text(json.dumps(told, indent=1))
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT / "demo.blend"), compress=True)
    print(json.dumps(told), (OUT / "demo.blend").stat().st_size, session.job.message, flush=True)


def steps() -> Iterator[float]:
    global begun
    OUT.mkdir(parents=True, exist_ok=True)
    for old in OUT.glob("*.jpg"):
        old.unlink()
    install(ZIP, PYTHON, empty=False)
    xdo("key", "Escape")  # the splash screen
    yield 2.0
    begun = time.monotonic()
    yield from get_a_body()
    yield from train()
    yield from take_along()
    keep()


play(steps())
