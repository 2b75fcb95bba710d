"""The user's Blender, in a process of its own: where it is, and files that only it reads (Alembic, USD, FBX, .blend).

Cloak itself never imports it.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cloak_core.files.errors import InputError
from cloak_core.files.reading import MAX_TEXT_BYTES, read_npz, read_text
from cloak_core.sources.bodies.meshes.mesh_file import MeshFile, to_srgb

ROOT = Path(__file__).resolve().parents[4]
# The bpy package may wait for ever at a regular exit.
VERSION = "import os, bpy; print(bpy.app.version_string, flush=True); os._exit(0)"
IN_BACKGROUND = ("-b", "--factory-startup", "-P")


class NoBlender(InputError):
    """There is no Blender on this machine."""


def blender_command(work: str) -> list[str]:
    """Find a command that runs a script in Blender: $CLOAK_BLENDER, a Python with bpy, or `blender` on the path.

    work: what it is for, the beginning of the message. NoBlender: there is none.
    """
    named = os.environ.get("CLOAK_BLENDER")
    if named and shutil.which(named) is None:
        raise NoBlender(f"{work}, and CLOAK_BLENDER={named} is no program")
    if named and Path(named).name.startswith("blender"):
        return [named, *IN_BACKGROUND]
    places = [named] if named else []
    places += [sys.executable] if importlib.util.find_spec("bpy") else []
    places += [str(place) for place in sorted(ROOT.glob(".venv-blender*/bin/python"))]
    if python := next((place for place in places if blender_version([place])), None):
        return [python]
    if blender := shutil.which("blender"):
        return [blender, *IN_BACKGROUND]
    raise NoBlender(
        f"{work}, and there is no Blender: put one on the path, name it in CLOAK_BLENDER, or pip install bpy"
    )


def blender_version(command: Sequence[str]) -> str:
    """Ask a Blender, or a Python with bpy, for its version, such as "4.2.0"; "" where it does not answer."""
    is_blender = "-P" in command
    words = [command[0], *(["-b", "--factory-startup", "--python-expr"] if is_blender else ["-c"]), VERSION]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip().splitlines()[-1]


SUFFIXES = (".abc", ".usd", ".usda", ".usdc", ".usdz", ".fbx", ".blend")
SCRIPT = Path(__file__).with_name("inside.py")


def read_through_blender(path: Path, frames: int = 0) -> MeshFile:
    """Read all visible meshes of a file as one, at its first frame or at `frames` > 0 moments of its animation.

    Raises `InputError` where there is no Blender, where it cannot read the file, and for the frame whose topology
    differs from the first one's.
    """
    command = blender_command(f"{path}: {path.suffix} files are read through Blender")
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "mesh.npz"
        environment["BLENDER_USER_RESOURCES"] = folder
        arguments = [str(SCRIPT), "--", str(path.resolve()), str(frames), str(out)]
        done = subprocess.run([*command, *arguments], capture_output=True, text=True, env=environment, check=False)
        reason = out.with_name("mesh.npz.error")
        if reason.exists():
            raise InputError(f"{path}: {read_text(reason, MAX_TEXT_BYTES)}")
        if done.returncode or not out.exists():
            last = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["it said nothing"]
            raise InputError(f"{path}: Blender could not read it ({last[0]})")
        return mesh_of(read_npz(out))


def mesh_of(arrays: dict[str, np.ndarray]) -> MeshFile:
    """Build the mesh that the script wrote."""
    corner_uv = arrays["corner_uv"].astype(float)
    known = np.isfinite(corner_uv).all(axis=1)
    return MeshFile(
        poses=arrays["poses"],
        loop_total=arrays["loop_total"].astype(np.int64),
        loop_vertices=arrays["loop_vertices"].astype(np.int64),
        face_colors=to_srgb(arrays["linear_colors"]),
        uv=corner_uv,
        loop_uv=np.where(known, np.arange(len(corner_uv)), -1),
        pictures=[arrays[f"picture_{n}"] for n in range(sum(key.startswith("picture_") for key in arrays) - 1)],
        picture_of=arrays["picture_of"].astype(np.int64),
    )
