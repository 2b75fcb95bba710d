"""The question that installing the trainer asks, and the preferences behind it, for a screenshot.

    window.sh OUT.png tools/blender/show_install.py ZIP WHEEL

The Python it offers is made up: what installs is tested in inside/test_install_trainer.py.
"""

import os
import subprocess
import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harness import MODULE, install, override, play, tidy

ZIP, WHEEL = sys.argv[sys.argv.index("--") + 1 :][:2]


def steps():
    install(ZIP)
    from cloak.trainer import install as trainer_install

    bpy.context.preferences.system.use_online_access = False
    assert not bpy.ops.cloak.install_trainer.poll(), "offline, nothing may be installed"
    bpy.context.preferences.system.use_online_access = True
    bpy.context.preferences.addons[MODULE].preferences.source = WHEEL
    base = trainer_install.Base("/usr/bin/python3", "3.13.5", "2.15.0", "/usr/lib/python3/dist-packages", True)
    trainer_install.find_base = lambda chosen="": base
    tidy()
    yield 1.0
    with override():
        bpy.context.area.type = "PREFERENCES"
        bpy.context.preferences.active_section = "EXTENSIONS"
        bpy.ops.preferences.addon_show(module=MODULE)
    yield 2.0
    subprocess.run(["xdotool", "mousemove", "640", "200"], check=True)
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window):
        bpy.ops.cloak.install_trainer("INVOKE_DEFAULT")
    yield 2.0
    Path(os.environ["SHOT_READY"]).touch()
    yield 3.0
    subprocess.run(["xdotool", "key", "Escape"], check=True)


play(steps())
