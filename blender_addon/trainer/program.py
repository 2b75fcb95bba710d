# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer is a program of its own, `cloak`: where it is found, and how it is started.

Looked for when it is first needed, in the places where `uv tool install`, `pipx install` and checkouts put it; nothing
is started for that. A Python that has `cloak_core` will do as well.
"""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import bpy

from ..files.errors import InputError

WHEEL = "PATH/cloak_core-VERSION-py3-none-any.whl"
SCRIPTS, PROGRAM = ("Scripts", "cloak.exe") if os.name == "nt" else ("bin", "cloak")
NO_WINDOW = {"creationflags": subprocess.CREATE_NO_WINDOW} if os.name == "nt" else {}
"""Options of subprocess that keep Windows from opening a console."""


def known_places() -> Iterator[Path]:
    """Where the program may be, the likeliest choice of the user first."""
    home, beside = Path.home(), Path(__file__).resolve().parents[2]  # a checkout that the add-on runs from
    places = (os.environ.get("CLOAK_PROGRAM"), beside / ".venv" / SCRIPTS / PROGRAM, shutil.which("cloak"))
    yield from map(Path, filter(None, places))
    folders = (os.environ.get("UV_TOOL_BIN_DIR"), os.environ.get("PIPX_BIN_DIR"), home / ".local" / "bin")
    yield from (Path(folder, PROGRAM) for folder in folders if folder)
    for tools in (".local/share/uv/tools", ".local/share/pipx/venvs", ".local/pipx/venvs", "AppData/Roaming/uv/tools"):
        yield home / tools / "cloak-core" / SCRIPTS / PROGRAM


def install_line(wheel: str = "") -> str:
    """What to type in a terminal to install the trainer from its wheel, wherever that lies: no index has it yet."""
    return f'uv tool install "{os.path.expanduser(wheel) or WHEEL}[onnx]"'


def find_program(chosen: str = "", wheel: str = "") -> str:
    """The program to train with: the chosen one, or the first in the known places; `InputError` says what to do.

    chosen: a program, a Python that has cloak_core, or the folder of a checkout or an environment.
    """
    if not chosen:
        found = (str(place) for place in known_places() if os.access(place, os.X_OK))
        if program := next(found, ""):
            return program
        raise InputError(f"No trainer found. To train, run this in a terminal: {install_line(wheel)}")
    path = Path(os.path.expanduser(chosen))
    inside = (path / folder / SCRIPTS / PROGRAM for folder in (".venv", ".")) if path.is_dir() else ()
    place = next((str(place) for place in inside if os.access(place, os.X_OK)), None) or shutil.which(str(path))
    if place is None:
        raise InputError(f"The trainer '{chosen}' cannot be run: choose another in the add-on's preferences")
    return place


def clean_environment() -> dict[str, str]:
    """The environment for the trainer: without what would point its Python at Blender's libraries.

    PYTHONSAFEPATH: nothing that happens to lie in the current folder is imported. CLOAK_OFFLINE: Blender's user allows
    no network, which `cloak remote` heeds.
    """
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP")}
    environment |= {"PYTHONUTF8": "1", "PYTHONUNBUFFERED": "1", "PYTHONSAFEPATH": "1"}
    return environment if bpy.app.online_access else environment | {"CLOAK_OFFLINE": "1"}


def start_process(command: list[str], out: Path | int, log: Path, **options: object) -> subprocess.Popen:
    """Start a program that works in the folder of its log, which it goes on writing. Raises `InputError`."""
    try:
        with log.open("ab") as errors, out.open("wb") if isinstance(out, Path) else nullcontext(out) as file:
            streams = {"stdout": file, "stderr": errors, "cwd": log.parent, "env": clean_environment()}
            return subprocess.Popen(command, **streams, **options, **NO_WINDOW)
    except OSError as error:
        raise InputError(f"{error.filename or command[0]}: cannot be started ({error.strerror})") from None
