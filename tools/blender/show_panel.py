"""Opens the panel in one of its states, in a real Blender window, for a screenshot.

    window.sh OUT.png tools/blender/show_panel.py ZIP STATE PYTHON FOLDER [de|fr]

STATE is body, logo, poses, train or result; `first`, what a newcomer finds: the sample body beside the cube of a new
file (in 1600 x 1000 Start must stand above the fold); or `try`, from an empty file to the picture of Try It, for which
FOLDER also gets `status.png` (while it trains) and `assets.png` (the ready cloths in the Asset Browser). PYTHON has
cloak_core; FOLDER is for runs (for result it may be a finished run on sample:train). When the window shows the state,
the file named by $SHOT_READY is made; a little later Blender quits. Any error ends Blender with exit code 3.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import frame, install, open_panel, play, show_all, show_tab, sidebar, tidy, until_done, view_area

ZIP, STATE, PYTHON, FOLDER, *LANGUAGE = sys.argv[sys.argv.index("--") + 1 :]
PANELS = {
    "body": ("body", "logo"),
    "logo": ("body", "logo", "stamp"),
    "poses": ("logo", "poses"),
    "train": ("jobs", "poses", "train", "settings"),
    "result": ("train", "runs", "result"),
}
OPENED = {"logo": "stamp", "poses": "poses", "train": "settings"}
SHOWN = {"de": "Mit Pinsel malen", "fr": "Peindre à la brosse"}


def speak(language: str) -> None:
    """Blender's whole window in another language; its names for languages differ between versions."""
    view = bpy.context.preferences.view
    view.language = next(name for name in bpy.app.translations.locales if name.split("_")[0] == language)
    view.use_translate_interface = view.use_translate_tooltips = True
    for context in ("*", "Operator"):
        assert bpy.app.translations.pgettext("Paint with a Brush", context) == SHOWN[language]


def begin() -> None:
    """The 3D viewport with its sidebar, without the splash screen."""
    subprocess.run(["xdotool", "key", "Escape"], check=True)
    view_area().spaces.active.show_region_ui = True


def first_look() -> Iterator[float]:
    bpy.ops.mesh.primitive_cube_add(size=2)
    cube = bpy.context.object  # named in the language of the window
    begin()
    yield 0.5
    bpy.ops.cloak.add_sample_body()
    yield from until_done()
    body = bpy.data.objects["Sample Body"]
    assert bpy.context.object == body and body.location.x - cube.location.x > 1, "it must not stand in the cube"
    yield from show_tab()
    yield 4.0


def photograph(name: str) -> None:
    subprocess.run(["import", "-window", "root", str(Path(FOLDER, name))], check=True)


def show_assets() -> Iterator[float]:
    """The Asset Browser with Cloak's library instead of the 3D viewport, for one picture."""
    area = view_area()
    area.ui_type = "ASSETS"
    yield 2.0
    area.spaces.active.params.asset_library_reference = "Cloak"
    yield 5.0
    photograph("assets.png")
    area.ui_type = "VIEW_3D"
    yield 1.0


def try_it() -> Iterator[float]:
    from cloak.session import session

    yield from show_assets()
    begin()
    yield from show_tab()
    bpy.context.scene.cloak.output = FOLDER
    bpy.ops.cloak.try_it()
    for label, step in (("Training", 30), ("Render check", 0)):
        while session.job.label != label or (session.job.progress.step < step if step else session.job.active):
            assert session.job.state not in ("failed", "stopped"), session.job.message
            yield 0.2
        if step:
            photograph("status.png")
    yield 3.0
    assert not session.job.is_bad_news, session.job.message
    areas = [area for window in bpy.context.window_manager.windows for area in window.screen.areas]
    shown = [area.spaces.active.image for area in areas if area.ui_type == "IMAGE_EDITOR" and area.spaces.active.image]
    assert [" after: scores, " in image.name for image in shown] == [True]


def step_of_the_panel() -> Iterator[float]:
    from cloak.session import session
    from cloak.trainer import jobs

    jobs.tell_status = lambda message: None  # no notice, though the panel is not yet shown
    tidy()
    yield 0.5
    bpy.ops.cloak.add_sample_body()
    yield from until_done()
    frame()
    settings = bpy.context.scene.cloak
    yield 0.5
    obj = bpy.context.view_layer.objects.active
    if STATE != "body":
        settings.stamp_text = "G"
        bpy.ops.cloak.logo_stamp()
    if STATE in ("poses", "train", "result"):
        obj.cloak.logo = "chest"
    if STATE == "result" and Path(FOLDER, "colors.npy").exists():  # a run of sample:train made beforehand
        obj.cloak.run = FOLDER
        bpy.ops.cloak.result_load()
        bpy.ops.cloak.use_standard_view()
    elif STATE in ("train", "result"):
        settings.output, settings.live_seconds = FOLDER, 0.5
        settings.frame_end = 3
        settings.steps = 400 if STATE == "train" else 25
        bpy.ops.cloak.train_start()
        while STATE == "train" and session.job.progress.step < 30:
            assert session.job.running, session.job.message
            yield 0.2
        if STATE == "result":
            yield from until_done()
    if STATE in OPENED:
        open_panel(OPENED[STATE])
    yield from sidebar(*PANELS[STATE])
    yield 1.5


def steps() -> Iterator[float]:
    """Run the steps in order; each yields the seconds that Blender may draw before the next."""
    install(ZIP, PYTHON)
    if LANGUAGE:
        speak(*LANGUAGE)
    yield from {"first": first_look, "try": try_it}.get(STATE, step_of_the_panel)()
    Path(os.environ["SHOT_READY"]).touch()
    yield 4.0
    show_all()
    if STATE == "train":
        from cloak.session import session

        bpy.ops.cloak.train_cancel()
        while session.job.running:
            yield 0.2
        assert session.job.state == "stopped", session.job.message


play(steps())
