# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer is another program: a Python that has `cloak_core`, and the `cloak` command lines the add-on gives it.

Nothing here imports `cloak_core`; the two sides share files and exit codes only.
"""

from __future__ import annotations

import functools
import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from .files.errors import InputError

INSTALL_LINE = "python3.11 -m venv .venv && .venv/bin/python -m pip install ."
"""Run in the folder of Cloak's sources."""

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


# --- finding a Python ------------------------------------------------------------------------------------------------


def clean_environment() -> dict[str, str]:
    """The environment for the trainer: without what would point its Python at Blender's libraries.

    PYTHONSAFEPATH: nothing that happens to lie in the current folder is imported.
    """
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP")}
    return environment | {"PYTHONUTF8": "1", "PYTHONUNBUFFERED": "1", "PYTHONSAFEPATH": "1"}


def candidates() -> list[str]:
    """Where a Python with `cloak_core` may be: $CLOAK_PYTHON, the checkout's .venv, an active environment, the path.

    `host-python` is the usual name of a wrapper that leaves a container.
    """
    folder = Path(__file__).resolve().parents[1]
    scripts, suffix = ("Scripts", ".exe") if os.name == "nt" else ("bin", "")
    places = [os.environ.get("CLOAK_PYTHON", "")]
    for root in (str(folder / ".venv"), os.environ.get("VIRTUAL_ENV", ""), os.environ.get("CONDA_PREFIX", "")):
        places.append(str(Path(root, scripts, f"python{suffix}")) if root else "")
    if Path(sys.executable).name.startswith("python"):
        places.append(sys.executable)
    places += [shutil.which(name) or "" for name in ("host-python", "python3", "python", "python3.11")]
    return list(dict.fromkeys(place for place in places if place and os.access(place, os.X_OK)))


def trainer_reason(python: str) -> str:
    """Why this Python cannot train; "" when it has everything. Takes a tenth of a second."""
    try:
        answer = _ask(python, _PROBE, timeout=20)
    except OSError as error:
        return f"cannot be run ({error.strerror})"
    except subprocess.TimeoutExpired:
        return "does not answer"
    if answer.returncode == 0:
        return ""
    said = answer.stderr.strip().splitlines()
    return "has no cloak_core" if answer.returncode == NO_TRAINER or not said else f"does not work: {said[-1][:200]}"


@functools.lru_cache(maxsize=1)
def _first_found() -> str:
    return next((python for python in candidates() if not trainer_reason(python)), "")


def find_python(chosen: str = "") -> str:
    """The Python to train with: the chosen one, checked to exist, or the first that is found.

    Raises `InputError` with what to do when there is none.
    """
    if chosen:
        path = shutil.which(os.path.expanduser(chosen))
        if path is None:
            raise InputError(f"Python '{chosen}' cannot be run: choose another in the add-on's preferences")
        reason = trainer_reason(path)
        if reason:
            raise InputError(f"Python '{chosen}' {reason}: install it there, or choose another in the preferences")
        return path
    python = _first_found()
    if not python:
        _first_found.cache_clear()
        raise InputError("No Python with cloak_core found: install it, then choose it in the add-on's preferences")
    return python


def about(python: str) -> dict[str, str]:
    """Versions and device of a trainer; imports torch over there, so it takes seconds."""
    try:
        answer = _ask(python, _ABOUT, timeout=120)
    except OSError as error:
        raise InputError(f"'{python}' cannot be run: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        raise InputError(f"'{python}' did not answer within two minutes") from None
    return parse_about(python, answer.returncode, answer.stdout, answer.stderr)


def about_command(python: str) -> list[str]:
    """The command behind `about`, for a job that runs it in the background."""
    return [python, "-c", _ABOUT]


def parse_about(python: str, code: int, stdout: str, stderr: str) -> dict[str, str]:
    """What the command behind `about` said, or `InputError` with its last line."""
    lines = stdout.strip().splitlines()
    if code == 0 and lines:
        try:
            record = json.loads(lines[-1])
            return {key: str(record[key]) for key in ("cloak", "torch", "python", "device")}
        except (ValueError, KeyError, TypeError):
            pass
    said = (stderr.strip().splitlines() or [f"exit code {code}"])[-1]
    raise InputError(f"'{python}' has no working cloak_core: {said}")


def _ask(python: str, code: str, timeout: float) -> subprocess.CompletedProcess:
    return subprocess.run(
        [python, "-c", code],
        capture_output=True,
        text=True,
        errors="replace",
        timeout=timeout,
        env=clean_environment(),
        stdin=subprocess.DEVNULL,
        **no_window(),
    )


def no_window() -> dict:
    """Keyword arguments of subprocess that keep Windows from opening a console."""
    return {"creationflags": subprocess.CREATE_NO_WINDOW} if os.name == "nt" else {}


# --- command lines ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TrainRequest:
    """Options of `cloak train`; empty strings and None leave the trainer's own default."""

    detector: str = "builtin"
    backgrounds: str = ""
    angles: str = "-10:10:5"
    preset: str = ""
    steps: int | None = None
    device: str = ""
    config: str = ""
    """TOML file with further settings of the trainer."""

    def options(self) -> list[str]:
        """As command line options."""
        given = {
            "--detector": self.detector,
            "--backgrounds": self.backgrounds,
            "--preset": self.preset,
            "--steps": "" if self.steps is None else str(self.steps),
            "--device": self.device,
            "--config": self.config,
        }
        # --angles=-10:10:5 in one word: a value that starts with a minus looks like an option otherwise.
        return [f"--angles={self.angles}"] + [word for pair in given.items() if pair[1] for word in pair]


def train_command(python: str, options: list[str], scene: Path, logo: Path, run: Path) -> list[str]:
    """`cloak train` on an export; `--resume` may be appended."""
    return [
        python,
        "-m",
        "cloak_core",
        "train",
        "--scene",
        str(scene),
        "--logo",
        str(logo),
        *options,
        "--out",
        str(run),
        "--json",
    ]


def heatmap_command(python: str, request: TrainRequest, scene: Path, out: Path) -> list[str]:
    """`cloak logo heatmap`."""
    words = [python, "-m", "cloak_core", "logo", "heatmap", "--scene", str(scene), "--detector", request.detector]
    words += [f"--angles={request.angles}", "--out", str(out), "--json"]
    return words + (["--backgrounds", request.backgrounds] if request.backgrounds else []) + _device(request)


def sample_command(python: str, out: Path) -> list[str]:
    """`cloak scene sample`."""
    return [python, "-m", "cloak_core", "scene", "sample", "--out", str(out), "--split", "train", "--json"]


def check_command(python: str, request: TrainRequest, image: Path) -> list[str]:
    """`cloak detectors check` on one image."""
    return [python, "-m", "cloak_core", "detectors", "check", request.detector, "--image", str(image), "--json"]


def report_command(python: str, run: Path) -> list[str]:
    """`cloak report`."""
    return [python, "-m", "cloak_core", "report", str(run), "--json"]


def _device(request: TrainRequest) -> list[str]:
    return ["--device", request.device] if request.device else []
