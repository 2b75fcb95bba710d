"""Finds Blender, or a Python in which it can be imported, to run scripts in. Cloak itself never imports it."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
ADD_ON = ROOT / "blender_addon"
# The bpy package may wait for ever at a regular exit.
PROBE = "import os, bpy; os._exit(0)"
IN_BACKGROUND = ("-b", "--factory-startup", "-P")


def find_blender() -> list[str] | None:
    """Find a command that runs a script in Blender: $CLOAK_BLENDER, a Python with bpy, or `blender` on the path."""
    named = os.environ.get("CLOAK_BLENDER")
    if named and Path(named).name.startswith("blender"):
        return [named, *IN_BACKGROUND]
    python = find_bpy()
    if python:
        return [python]
    blender = shutil.which("blender")
    return [blender, *IN_BACKGROUND] if blender else None


def find_bpy() -> str | None:
    """Find a Python that has the bpy package, first the one that $CLOAK_BLENDER names; None where there is none."""
    named = os.environ.get("CLOAK_BLENDER")
    places = [named] if named and not Path(named).name.startswith("blender") else []
    places += [sys.executable] if importlib.util.find_spec("bpy") else []
    places += [str(place) for place in sorted(ROOT.glob(".venv-blender*/bin/python"))]
    return next(filter(_has_bpy, places), None)


def bpy_version(python: str) -> str:
    """Read Blender's version in such a Python, such as "4.2.0"."""
    script = "import os, bpy; print(bpy.app.version_string, flush=True); os._exit(0)"
    said = subprocess.run([python, "-c", script], capture_output=True, text=True, timeout=60, check=True).stdout
    return said.strip().splitlines()[-1]


def _has_bpy(python: str) -> bool:
    try:
        return subprocess.run([python, "-c", PROBE], capture_output=True, timeout=60, check=False).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False
