# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer is a program of its own, `cloak`: where it is found, the preference that chooses it, and how it starts.

Looked for when it is first needed, in the places where `uv tool install`, `pipx install` and checkouts put it; nothing
is started for that. A Python that has `cloak_core` will do as well.
"""

import functools
import hashlib
import os
import shutil
import subprocess
import time
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import bpy

from ..files.errors import InputError
from ..files.reading import MAX_TEXT_BYTES, read_bytes
from ..files.specs import reach, split_spec, without_options
from ..session import session
from ..translations import said
from ..ui import props

PACKAGE = __package__.rpartition(".")[0]  # the add-on's name in Blender
LOOK_SECONDS = 5.0  # between two looks of the panel for the program
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
        programs = (str(place) for place in known_places() if os.access(place, os.X_OK))
        if program := next(programs, ""):
            return program
        raise InputError(f"No trainer found. To train, run this in a terminal: {install_line(wheel)}")
    path = Path(os.path.expanduser(chosen))
    inside = (path / folder / SCRIPTS / PROGRAM for folder in (".venv", ".")) if path.is_dir() else ()
    place = next((str(place) for place in inside if os.access(place, os.X_OK)), None) or shutil.which(str(path))
    if place is None:
        raise InputError(f"The trainer '{chosen}' cannot be run: choose another in the add-on's preferences")
    return place


class CloakPreferences(bpy.types.AddonPreferences):
    """Which trainer to use."""

    bl_idname = PACKAGE

    program: props.path(
        "Trainer",
        "The program cloak, a Python that has cloak_core, or the folder of a checkout; empty to look in known places",
        relative=False,
    )
    wheel: props.path("Wheel", "The file cloak_core-....whl, for the line that installs the trainer", relative=False)
    answer: props.text("Answer", "What the trainer said when it was last tested", options={"SKIP_SAVE"})

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        row = layout.row(align=True)
        row.prop(self, "program")
        row.operator("cloak.test_trainer", text="Test")
        if self.answer or trainer_reason():
            layout.label(text=said(self.answer or trainer_reason()), icon="INFO")
        box = layout.box()
        box.label(text="The trainer is a program of its own. To install it, run this in a terminal:")
        box.prop(self, "wheel")
        row = box.row(align=True)
        row.label(text=install_line(self.wheel))
        row.operator("cloak.copy_install_line", text="", icon="COPYDOWN")


def preferences() -> "CloakPreferences | SimpleNamespace":
    """Return the add-on's preferences; empty ones that are not stored if it is not installed."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    return addon.preferences if addon else SimpleNamespace(program="", wheel="", answer="")


def user_folder(name: str) -> Path:
    """A folder of the add-on's own for what can be made again, made if need be; removing the add-on removes it."""
    if PACKAGE.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(PACKAGE, path=name, create=True))
    return Path(bpy.utils.user_resource("DATAFILES", path=f"cloak/{name}", create=True))


def trainer() -> str:
    """The program to train with. Raises `InputError` with what to do."""
    return find_program(preferences().program, preferences().wheel)


def trainer_reason() -> str:
    """Why there is no trainer to start, "" when there is one; for redraws, which look every few seconds."""
    return _reason(preferences().program, preferences().wheel, time.monotonic() // LOOK_SECONDS)


@functools.lru_cache(1)
def _reason(program: str, wheel: str, moment: float) -> str:
    try:
        find_program(program, wheel)
    except InputError as error:
        return str(error)
    return ""


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


# --- its command lines; the two share files and exit codes, no import ------------------------------------------------

SAMPLES = {"BARE": "sample:train", "CLOTHED": "sample-clothed:train"}
"""Training splits of the sample people; the other splits are held out for evaluation."""


PASSED_ON = ("detector", "backgrounds", "angles", "preset", "steps", "device", "config")
OPTIONS = (*PASSED_ON, "init", "made-from")
"""Of `cloak train`: what the user sets, and with it what the add-on sets."""


def options(detectors: Iterable[str], **values: object) -> list[str]:
    """Options of a command: each detector, and the values by their names; "" and None leave the trainer's default."""
    # In one word: a value that starts with a minus looks like an option otherwise.
    named = [f"--{name}={value}" for name, value in values.items() if value not in ("", None)]
    return [*(f"--detector={spec}" for spec in detectors), *named]


def differing_options(begun: list[str], now: list[str]) -> str:
    """What a run was started with where the options are others now: "steps 60 (not 120), ..."; "" where nothing is."""
    was, wanted = _values(begun), _values(now)
    names = [name for name in was | wanted if was.get(name) != wanted.get(name)]
    return ", ".join(
        f"{name.strip('-')} {was.get(name, 'as by default')} (not {wanted.get(name, 'the default')})"
        for name in names
        if name not in ("--init", "--made-from")
    )


def _values(words: list[str]) -> dict[str, str]:
    """Return the values by option; repeated options are joined."""
    values: dict[str, str] = {}
    for name, _, value in (word.partition("=") for word in words):
        values[name] = f"{values[name]}, {value}" if name in values else value
    return values


def absolute_detector(spec: str) -> str:
    """A detector's name with the files in it as absolute paths: the trainer works in a folder of its own."""
    parts = split_spec(spec)
    for number, part in enumerate(parts):
        for path in (part, part.rpartition("@")[0]):  # what follows the @ are options
            if path and Path(path).is_file():
                parts[number] = str(Path(path).absolute()) + part[len(path) :]
                break
    return ":".join(parts)


def cloak_command(program: str, *words: object) -> list[str]:
    """A command of the trainer, `cloak WORDS...`, that prints its answer as JSON.

    Every command passes here: raises `Unasked` where a word needs the user's yes first.
    """
    words = [str(word) for word in words]
    require(words)
    module = ["-m", "cloak_core"] if "python" in Path(program).name.lower() else []
    return [program, *module, *words, "--json"]


def train_command(program: str, options: list[str], scene: Path, logo: Path, run: Path) -> list[str]:
    """Return the command line of `cloak train` on an export; `--resume` may be appended."""
    return cloak_command(program, "train", "--scene", scene, "--logo", logo, *options, "--out", run)


def sample_words(out: Path, people: str = "BARE") -> list[object]:
    """`cloak scene sample`; `people` are a key of `SAMPLES`."""
    clothed = ["--clothed"] if people == "CLOTHED" else []
    return ["scene", "sample", "--out", out, "--split", SAMPLES[people].partition(":")[2], *clothed]


class Unasked(InputError):
    """The user has not been asked about `specs` yet."""

    def __init__(self, specs: list[str]) -> None:
        super().__init__(
            f"{specs[0]} {reach(specs[0])}, and waits for your yes (without a window: --detector names it)"
        )
        self.specs = specs


def allow(words: Iterable[str]) -> None:
    """Take these words of a command line for named by the user."""
    session.allowed |= set(map(_content, _acting(words)))


def require(words: Iterable[str]) -> None:
    """Raise `Unasked` for words of a command line that run code or ask the network and have no yes."""
    if unasked := [spec for spec in _acting(words) if _content(spec) not in session.allowed]:
        raise Unasked(unasked)


def _acting(words: Iterable[str]) -> list[str]:
    values = (word.partition("=")[2] if word.startswith("--") else word for word in words)
    return [value for value in values if reach(value)]


def _content(spec: str) -> str:
    bare = without_options(spec)
    files = (Path(part) for part in split_spec(bare))
    code = [read_bytes(file, MAX_TEXT_BYTES) for file in files if file.is_file()] if reach(bare) == "runs code" else []
    return hashlib.sha256(b"\0".join([bare.encode(), *code])).hexdigest()
