"""What the scripts of this folder share: the installed extension, and steps between which Blender draws its window."""

import json
import os
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy

HIDDEN = []
"""Panels that `sidebar` took away."""
MODULE = "bl_ext.user_default.cloak"
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "blender" / "inside"))


def install(package: str, python: str = "", empty: bool = True) -> None:
    """Install and enable the extension, known as `cloak` afterwards; the file without its cube, unless not `empty`."""
    bpy.ops.extensions.package_install_files(filepath=package, repo="user_default", enable_on_install=True)
    bpy.context.preferences.addons[MODULE].preferences.program = python
    bpy.context.preferences.view.show_splash = False
    for name in [name for name in sys.modules if name.split(".")[:3] == MODULE.split(".")]:
        sys.modules[name.replace(MODULE, "cloak", 1)] = sys.modules[name]
    for obj in list(bpy.data.objects) if empty else ():
        bpy.data.objects.remove(obj)


def play(steps: Iterator[float]) -> None:
    """Take the next step when the seconds that the last one yielded have passed; at the end close Blender.

    The first error ends it with exit code 3.
    """

    def take() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            print("done", flush=True)
        except Exception:
            traceback.print_exc()
            os._exit(3)
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(take, first_interval=1.0)


def until_done() -> Iterator[float]:
    """Steps until the current job has ended well."""
    from cloak.session import session

    while session.job.running:
        yield 0.2
    assert session.job.state == "done", session.job.message


# --- the window -------------------------------------------------------------------------------------------------------


def view_area():
    return next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == "VIEW_3D")


def override():
    area = view_area()
    region = next(r for r in area.regions if r.type == "WINDOW")
    return bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area, region=region)


def tidy():
    """The 3D viewport alone, its sidebar on the Cloak tab, the body filling the view."""
    subprocess.run(["xdotool", "key", "Escape"], check=True)  # the splash screen
    with override():
        bpy.ops.screen.screen_full_area(use_hide_panels=False)
    area = view_area()
    area.spaces.active.show_region_ui = True
    area.spaces.active.overlay.show_floor = True


def frame():
    with override():
        bpy.ops.view3d.view_axis(type="FRONT")
        bpy.ops.view3d.view_selected()
        bpy.ops.view3d.view_orbit(angle=0.35, type="ORBITRIGHT")


def sidebar(*names):
    """Show the Cloak tab, and of its panels only those named."""
    yield from show_tab()
    for cls in reversed(sys.modules["cloak"].CLASSES):  # those inside others first
        short = cls.__name__.removeprefix("CLOAK_PT_")
        if short != cls.__name__ and short not in names and cls.is_registered:
            bpy.utils.unregister_class(cls)
            HIDDEN.append(cls)
    yield from show_tab()


def show_tab():
    for _ in range(3):  # the tab is there once its panels have been drawn
        area = view_area()
        area.tag_redraw()
        yield 0.5
        next(r for r in area.regions if r.type == "UI").active_panel_category = "Cloak"


def show_all():
    """Bring back the panels that `sidebar` took away."""
    while HIDDEN:
        bpy.utils.register_class(HIDDEN.pop())


def open_panel(name):
    """A panel that is closed by default, open."""
    cls = next(c for c in sys.modules["cloak"].CLASSES if c.__name__ == f"CLOAK_PT_{name}")
    bpy.utils.unregister_class(cls)
    cls.bl_options = set()
    bpy.utils.register_class(cls)


def print_figures(measure: Callable[[], dict]) -> None:
    """Print what is measured as one JSON object, and end Blender: at once, or from its window when that is up."""

    def main() -> None:
        try:
            print(json.dumps(measure(), indent=1), flush=True)
        except Exception:
            traceback.print_exc()
            os._exit(3)
        if bpy.app.background:
            os._exit(0)
        Path(os.environ["SHOT_READY"]).touch()
        bpy.app.timers.register(lambda: bpy.ops.wm.quit_blender() and None, first_interval=3)

    if bpy.app.background:
        main()
    else:
        bpy.app.timers.register(main, first_interval=1.5)
