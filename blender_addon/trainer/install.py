# SPDX-License-Identifier: GPL-3.0-or-later
"""Installing the trainer: an environment made by a Python that is there, filled by pip from the user's index.

Nothing here names an index: pip reads the user's own configuration (pip.conf, PIP_* variables).
"""

import contextlib
import json
import os
import re
import shutil
import signal
import threading
from dataclasses import dataclass
from pathlib import Path

from ..files.errors import InputError
from .jobs import Job
from .python import PYTHON, about_command, ask, candidates

PYTHON_NEEDED, TORCH_NEEDED = (3, 11), (2, 14)
PIP_FOR_OTHERS = (22, 3)  # from here on, pip can fill an environment that has none of its own: its option --python
GIGABYTES, GIGABYTES_WITHOUT_TORCH = 6.0, 0.6  # size on disk; torch, torchvision and CUDA take 5.4 GB of it
_PROBE = """
import importlib.util, json, platform, sys, venv
from importlib.metadata import PackageNotFoundError, distribution
def version(name):
    try:
        return distribution(name).version
    except PackageNotFoundError:
        return ""
torch = version("torchvision") and version("torch")
print(json.dumps({
    "python": sys.executable,
    "version": platform.python_version(),
    "pip": version("pip"),
    "ensurepip": importlib.util.find_spec("ensurepip") is not None,
    "torch": torch,
    "torch_folder": str(distribution("torch").locate_file("")) if torch else "",
}))
"""
_SHARE = """
import pathlib, sys, sysconfig
pathlib.Path(sysconfig.get_path("purelib"), "torch.pth").write_text(sys.argv[1] + "\\n", "utf-8")
"""


@dataclass(frozen=True)
class Base:
    """A Python that can make environments."""

    python: str
    version: str
    torch: str = ""  # version of the torch it has, if that is new enough and torchvision is beside it
    torch_folder: str = ""
    lends_pip: bool = False  # its own pip fills the environment, which spares the seconds of copying one there

    def describe(self) -> str:
        return f"{self.python} ({self.version}{f', torch {self.torch}' if self.torch else ''})"


def read_base(python: str) -> Base:
    """Ask a Python whether it can make environments; `InputError` says why not. Takes a tenth of a second."""
    try:
        answer = ask(python, _PROBE)
    except InputError as error:
        raise InputError(f"Python '{python}' {error}") from None
    said, about = (answer.stderr.strip().splitlines() or ["no answer"])[-1], {}
    if answer.returncode and "No module named 'venv'" not in said:
        raise InputError(f"Python '{python}' does not work: {said[:200]}")
    if not answer.returncode:
        try:
            about = {key: str(value) for key, value in json.loads(answer.stdout.strip().splitlines()[-1]).items()}
        except (ValueError, IndexError, AttributeError):
            raise InputError(f"Python '{python}' gives no sensible answer") from None
    lends_pip = _numbers(about.get("pip", "")) >= PIP_FOR_OTHERS
    if not lends_pip and about.get("ensurepip") != "True":
        raise InputError(
            f"Python '{python}' has neither venv nor pip: install them (on Debian and Ubuntu the package python3-venv)"
        )
    if _numbers(about["version"]) < PYTHON_NEEDED:
        raise InputError(f"Python '{python}' is {about['version']}; the trainer needs 3.11 or newer")
    if not os.access(about["python"], os.X_OK):
        raise InputError(f"Python '{python}' lies outside of what Blender can reach")
    new = _numbers(about["torch"]) >= TORCH_NEEDED
    torch = (about["torch"], about["torch_folder"]) if new else ("", "")
    return Base(python, about["version"], *torch, lends_pip)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version.split("+")[0])[:2])


def find_base(chosen: str = "") -> Base:
    """The chosen Python, or the first that can make environments; `InputError` says what is wrong with each."""
    if chosen:
        return read_base(shutil.which(os.path.expanduser(chosen)) or chosen)
    reasons = []
    for python in candidates():
        try:
            return read_base(python)
        except InputError as error:
            reasons.append(str(error))
    raise InputError("; ".join(reasons) or "No Python 3.11 or newer found: install one, then choose it here")


def find_source(chosen: str) -> Path:
    """What pip installs: the wheel or the folder of sources that was chosen, or the wheel that came with the add-on."""
    if not chosen:
        if wheels := sorted(Path(__file__).parent.glob("*.whl")):
            return wheels[-1]
        raise InputError("Choose what to install: the trainer's wheel (.whl), or the folder of Cloak's sources")
    path = Path(chosen).expanduser()
    if path.is_dir():
        if not (path / "pyproject.toml").is_file():
            raise InputError(f"{path} does not hold Cloak's sources (no pyproject.toml in it)")
    elif not path.is_file() or not path.name.endswith((".whl", ".tar.gz")):
        raise InputError(f"{path} is neither a wheel (.whl) nor a folder of sources")
    return path


def gigabytes(base: Base, share_torch: bool) -> float:
    """What the trainer takes on the disk."""
    return GIGABYTES_WITHOUT_TORCH if share_torch and base.torch else GIGABYTES


def require_room(folder: Path, needed: float) -> None:
    """Raise `InputError` unless the folder is writable and its disk has this many gigabytes free."""
    try:
        free = shutil.disk_usage(folder).free / 1e9
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}") from None
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder} cannot be written: no permission")
    if free < needed:
        raise InputError(f"{folder}: the trainer takes about {needed:.1f} GB, but only {free:.1f} GB are free there")


def python_in(place: Path) -> str:
    """The Python of an environment."""
    return str(place / PYTHON)


def install_commands(base: Base, place: Path, source: Path, share_torch: bool) -> list[list[str]]:
    """Make the environment, let it see the base's torch if wanted, fill it, start what came of it."""
    python = python_in(place)
    share = [[python, "-c", _SHARE, base.torch_folder]] if share_torch and base.torch else []
    pip = [base.python, "-m", "pip", "--python", python] if base.lends_pip else [python, "-m", "pip"]
    return [
        [base.python, "-m", "venv", *(["--without-pip"] if base.lends_pip else []), str(place)],
        *share,
        [*pip, "install", "--no-input", "--disable-pip-version-check", str(source)],
        about_command(python),
    ]


def sweep(folder: Path, keep: Path | None) -> threading.Thread:
    """Remove every environment but one, without keeping anybody waiting: they hold thousands of files."""
    places = [place for place in folder.glob("*") if place.is_dir() and place != keep]
    remove = lambda: [shutil.rmtree(place, ignore_errors=True) for place in places]
    thread = threading.Thread(target=remove, name="cloak sweeps", daemon=True)
    thread.start()
    return thread


class InstallJob(Job):
    """The commands of an installation; what pip says last is its description."""

    def _describe_running(self) -> str:
        said = "".join(f": {line[:80]}" for line in self.tail(1) if not self._cancelled)
        return super()._describe_running() + said

    def tail(self, count: int) -> list[str]:
        """The last lines that the commands said."""
        lines = [line.strip() for line in self.everything().splitlines()]
        return [line for line in lines if line][-count:]

    def everything(self) -> str:
        """All that was said: to standard error, then to standard output."""
        log = self.log.read_text("utf-8", "replace") if self.log.is_file() else ""
        return "\n".join([log, *self.outputs, *([self._said()] if self.running else [])])

    @property
    def complete(self) -> bool:
        """Whether every command has ended well."""
        return self.state == "done" and len(self.outputs) == len(self._commands)

    def _terminate(self) -> None:
        if os.name != "posix":
            super()._terminate()
            return
        with contextlib.suppress(OSError):  # pip and venv have children of their own
            os.killpg(self._process.pid, signal.SIGTERM)


_DIAGNOSES = (
    (r"No space left on device|Errno 28", "The disk is full: make room, or share a Python's torch"),
    (r"ensurepip is not available|No module named '?(ensurepip|venv|pip)\b",
     "This Python has no pip: install it (on Debian and Ubuntu the package python3-venv), or choose another Python"),
    (r"CERTIFICATE_VERIFY_FAILED|SSLError", "The package index's certificate is not trusted: see pip's configuration"),
    (r"NewConnectionError|Max retries exceeded|ConnectTimeout|Temporary failure in name resolution|ProxyError",
     "The package index cannot be reached: check the network, the proxy and pip's configuration"),
    (r"requires a different Python", "This Python does not suit the trainer: choose another"),
    (r"No matching distribution found for (?P<what>\S+)",
     "The package index has no suitable {what}: check pip's configuration (pip config list)"),
    (r"Permission denied|Errno 13", "The folder cannot be written: no permission"),
    (r"is not a supported wheel on this platform", "The wheel is for another system or Python"),
)  # fmt: skip


def diagnosis(said: str, otherwise: str) -> str:
    """What went wrong, from all that the commands said, and what to do."""
    for pattern, words in _DIAGNOSES:
        if found := re.search(pattern, said):
            return words.format(what=found.groupdict().get("what") or "package")
    return otherwise
