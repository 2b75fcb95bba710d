# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer is another program: finding a Python that has `cloak_core`, and asking it about itself."""

import functools
import json
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from ..files.errors import InputError

INSTALL_LINE = "python3.11 -m venv .venv && .venv/bin/python -m pip install ."  # run in the folder of Cloak's sources
PYTHON = Path("Scripts", "python.exe") if os.name == "nt" else Path("bin", "python")
"""Where an environment has its Python."""
_PROBE = (
    "import importlib.util as u, sys; "
    "sys.exit(0 if all(u.find_spec(m) for m in ('cloak_core', 'torch', 'numpy')) else 9)"
)
NO_TRAINER = 9
_ABOUT = """
import json, platform
import cloak_core, torch
device = torch.cuda.get_device_name(0) if torch.cuda.is_available() else "CPU, %d threads" % torch.get_num_threads()
print(json.dumps({"cloak": cloak_core.__version__, "torch": torch.__version__, "python": platform.python_version(),
                  "device": device}))
"""
NO_WINDOW = {"creationflags": subprocess.CREATE_NO_WINDOW} if os.name == "nt" else {}
"""Options of subprocess that keep Windows from opening a console."""


def clean_environment() -> dict[str, str]:
    """The environment for the trainer: without what would point its Python at Blender's libraries.

    PYTHONSAFEPATH: nothing that happens to lie in the current folder is imported.
    """
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP")}
    return environment | {"PYTHONUTF8": "1", "PYTHONUNBUFFERED": "1", "PYTHONSAFEPATH": "1"}


def start_process(command: list[str], out: Path | int, log: Path, **options: object) -> subprocess.Popen:
    """Start a program that works in the folder of its log, which it goes on writing. Raises `InputError`."""
    try:
        with log.open("ab") as errors, out.open("wb") if isinstance(out, Path) else nullcontext(out) as file:
            streams = {"stdout": file, "stderr": errors, "cwd": log.parent, "env": clean_environment()}
            return subprocess.Popen(command, **streams, **options, **NO_WINDOW)
    except OSError as error:
        raise InputError(f"{error.filename or command[0]}: cannot be started ({error.strerror})") from None


def candidates() -> list[str]:
    """Where a Python with `cloak_core` may be: $CLOAK_PYTHON, the checkout's .venv, an active environment, the path.

    `host-python` is the usual name of a wrapper that leaves a container.
    """
    checkout, get = Path(__file__).resolve().parents[2], os.environ.get
    roots = filter(None, (str(checkout / ".venv"), get("VIRTUAL_ENV"), get("CONDA_PREFIX")))
    places = [get("CLOAK_PYTHON"), *(str(root / PYTHON) for root in map(Path, roots))]
    if Path(sys.executable).name.startswith("python"):
        places.append(sys.executable)
    places += map(shutil.which, ("host-python", "python3", "python", "python3.11"))
    return list(dict.fromkeys(place for place in places if place and os.access(place, os.X_OK)))


def ask(python: str, program: str) -> subprocess.CompletedProcess:
    """What a Python answers to a short program. Raises `InputError`, without the Python's name: it does not answer."""
    try:
        streams = {"capture_output": True, "text": True, "errors": "replace", "stdin": subprocess.DEVNULL}
        return subprocess.run([python, "-c", program], timeout=20, env=clean_environment(), **streams, **NO_WINDOW)
    except OSError as error:
        raise InputError(f"cannot be run ({error.strerror})") from None
    except subprocess.TimeoutExpired:
        raise InputError("does not answer") from None


def trainer_reason(python: str) -> str:
    """Why this Python cannot train; "" when it has everything. Takes a tenth of a second."""
    try:
        answer = ask(python, _PROBE)
    except InputError as error:
        return str(error)
    if answer.returncode == 0:
        return ""
    said = answer.stderr.strip().splitlines()
    return "has no cloak_core" if answer.returncode == NO_TRAINER or not said else f"does not work: {said[-1][:200]}"


class Question(threading.Thread):
    """Asks Pythons about themselves in a thread; `answer` is None until it is known, or the `InputError` of asking."""

    def __init__(self, ask: Callable[[], Any]) -> None:
        super().__init__(name="cloak asks for a trainer", daemon=True)
        self._ask = ask
        self.answer: Any = None
        self.start()

    def run(self) -> None:
        try:
            self.answer = self._ask()
        except InputError as error:
            self.answer = error


_questions: dict[str, Question] = {}
"""By the chosen Python: why it cannot train. By "": the first Python that can, "" for none."""


def _question(chosen: str) -> Question | None:
    """What is being found out, or known, of the chosen Python, or of "" for any; None where it cannot be run."""
    path = shutil.which(os.path.expanduser(chosen)) if chosen else ""
    if path is not None and chosen not in _questions:
        find = lambda: next((python for python in candidates() if not trainer_reason(python)), "")
        _questions[chosen] = Question(functools.partial(trainer_reason, path) if path else find)
    return None if path is None else _questions[chosen]


def known_reason(chosen: str = "") -> str | None:
    """Why `find_python` would refuse, "" when it would not, None while that is being found out. Never waits."""
    question = _question(chosen)
    if question is None:
        return f"The trainer's Python '{chosen}' cannot be run"
    answer = question.answer
    if not chosen and answer is not None:
        return "" if answer else "No trainer yet: install it, or choose its Python"
    return f"The trainer's Python '{chosen}' {answer}" if answer else answer


def forget_answers() -> None:
    """Forget what is known of Pythons: something may have been installed."""
    _questions.clear()


def find_python(chosen: str = "", seconds: float = threading.TIMEOUT_MAX) -> str:
    """The Python to train with: the chosen one, checked to exist, or the first that is found.

    Waits so many seconds at most. A chosen Python that has not answered by then is taken at its word. Raises
    `InputError` with what to do when there is none, or none yet.
    """
    question = _question(chosen)
    if question is None:
        raise InputError(f"Python '{chosen}' cannot be run: choose another in the add-on's preferences")
    question.join(min(seconds, threading.TIMEOUT_MAX))
    answer = question.answer
    if answer is not None and bool(answer) == bool(chosen):
        del _questions[chosen]  # a refusal, or nothing found: ask again the next time
    if chosen and answer:
        raise InputError(f"Python '{chosen}' {answer}: install it there, or choose another in the preferences")
    if not chosen and answer is None:
        raise InputError("Still looking for a Python with cloak_core: try again in a moment")
    if not chosen and not answer:
        raise InputError("No Python with cloak_core found: install it, then choose it in the add-on's preferences")
    return shutil.which(os.path.expanduser(chosen)) if chosen else answer


def about_command(python: str) -> list[str]:
    """Asks a trainer for its versions and device; it imports torch, so the answer takes seconds."""
    return [python, "-c", _ABOUT]


def parse_about(python: str, done: bool, stdout: str, last_line: str) -> dict[str, str]:
    """What `about_command` printed, or `InputError` with the last line of its log."""
    try:
        record = json.loads(stdout.strip().splitlines()[-1]) if done else {}
        return {key: str(record[key]) for key in ("cloak", "torch", "python", "device")}
    except (ValueError, KeyError, TypeError, IndexError):
        raise InputError(f"'{python}' has no working cloak_core: {last_line or 'no answer'}") from None
