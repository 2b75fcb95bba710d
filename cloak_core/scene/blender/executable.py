"""Finds a Python in which Blender can be imported, to run the add-on's scripts. Cloak itself never imports it."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
ADD_ON = ROOT / "blender_addon"
# The bpy package may wait for ever at a regular exit.
PROBE = "import os, bpy; os._exit(0)"


def find_blender(script: str) -> str | None:
    """A Python that has the bpy package, where the add-on's `script` is there to run; else None."""
    if not (ADD_ON / script).exists():
        return None
    places = [sys.executable] if importlib.util.find_spec("bpy") else []
    places += [str(place) for place in sorted(ROOT.glob(".venv-blender*/bin/python"))]
    for python in places:
        try:
            if subprocess.run([python, "-c", PROBE], capture_output=True, timeout=60, check=False).returncode == 0:
                return python
        except (OSError, subprocess.TimeoutExpired):
            continue
    return None
