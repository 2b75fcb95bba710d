"""What the scripts of this folder share: the installed extension, and steps between which Blender draws its window."""

import os
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path

import bpy

MODULE = "bl_ext.user_default.cloak"
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "inside"))


def install(package: str, python: str = "") -> None:
    """Install and enable the extension, known as `cloak` afterwards; an empty file."""
    bpy.ops.extensions.package_install_files(filepath=package, repo="user_default", enable_on_install=True)
    bpy.context.preferences.addons[MODULE].preferences.python = python
    bpy.context.preferences.view.show_splash = False
    for name in [name for name in sys.modules if name.split(".")[:3] == MODULE.split(".")]:
        sys.modules[name.replace(MODULE, "cloak", 1)] = sys.modules[name]
    for obj in list(bpy.data.objects):
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
    from cloak import jobs

    while jobs.current.running:
        yield 0.2
    assert jobs.current.state == "done", jobs.current.message
