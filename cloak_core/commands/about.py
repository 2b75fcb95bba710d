"""What this trainer is: its version, completion by a shell, and another one in an environment of its own."""

from __future__ import annotations

import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from cloak_core import __version__
from cloak_core.commands.base import Command, err, out
from cloak_core.files.errors import InputError
from cloak_core.files.writing import require_new, write_text

SCRIPTS, PYTHON, PROGRAM = ("Scripts", "python.exe", "cloak.exe") if os.name == "nt" else ("bin", "python", "cloak")
GIGABYTES, GIGABYTES_WITHOUT_TORCH = 6.0, 0.6
"""Size on disk; torch, torchvision and CUDA take 5.4 of it."""


@dataclass(kw_only=True)
class Version(Command):
    """Print the version and those of its parts, for reports of defects."""

    def run(self) -> dict:
        from cloak_core.files.identity import package_versions

        packages = package_versions("torch", "torchvision", "numba", "numpy")
        return {"version": __version__, "python": platform.python_version(), "system": platform.platform()} | packages

    def show(self, result: dict) -> None:
        out.print(f"cloak {result['version']}")
        out.print(", ".join(f"{name} {value}" for name, value in result.items() if name != "version"))


@dataclass(kw_only=True)
class Completion(Command):
    """Print a script with which a shell completes commands and options.

    bash: eval "$(cloak completion bash)" in ~/.bashrc. zsh: the same in ~/.zshrc. fish: cloak completion fish >
    ~/.config/fish/completions/cloak.fish
    """

    example = "bash"

    shell: Positional[Literal["bash", "zsh", "fish"]]
    """bash, zsh or fish."""

    def run(self) -> dict:
        from cloak_core.cli import COMMANDS, load
        from cloak_core.commands.help import flags, summary

        known = {name: (summary(cls.__doc__ or ""), flags(cls)) for name in COMMANDS for cls in [load(name)]}
        lines = _fish(known) if self.shell == "fish" else _bash(known, self.shell)
        return {"shell": self.shell, "script": "\n".join(lines) + "\n"}

    def show(self, result: dict) -> None:
        print(result["script"], end="")


Known = dict[str, tuple[str, dict[str, str]]]
"""Command -> what it does, and its options with what they mean."""


def _bash(known: Known, shell: str) -> Iterator[str]:
    """Yield the lines of a completion function; zsh runs it through its bashcompinit."""
    words = _tree(known)
    if shell == "zsh":
        yield "autoload -U +X compinit && compinit; autoload -U +X bashcompinit && bashcompinit"
    yield "_cloak() {"
    yield '  local current="${COMP_WORDS[COMP_CWORD]}" first="${COMP_WORDS[1]}" second="${COMP_WORDS[2]}" words=""'
    yield '  if [ "$COMP_CWORD" -eq 1 ]; then'
    yield f'    words="{" ".join(words)}"'
    yield '  elif [ "$COMP_CWORD" -eq 2 ] && [[ "$current" != -* ]]; then'
    yield '    case "$first" in'
    for first, inner in words.items():
        yield f'      {first}) words="{" ".join(filter(None, inner))}" ;;'
    yield "    esac"
    yield "  fi"
    yield '  if [[ "$current" == -* ]]; then'
    yield '    case "$first $second" in'
    # Commands of two words stand before those of one, which would match them, too.
    for name in sorted(known, key=lambda name: -name.count(" ")):
        yield f'      "{name}"*) words="{" ".join(known[name][1])}" ;;'
    yield "    esac"
    yield "  fi"
    yield '  COMPREPLY=( $(compgen -W "$words" -- "$current") )'
    yield "}"
    yield "complete -o default -F _cloak cloak"


def _fish(known: Known) -> Iterator[str]:
    for first, inner in _tree(known).items():
        yield f"complete -c cloak -n __fish_use_subcommand -f -a {first} -d {_quoted(inner.get('', f'{first} ...'))}"
        more = {second: about for second, about in inner.items() if second}
        there = f"__fish_seen_subcommand_from {first}; and not __fish_seen_subcommand_from {' '.join(more)}"
        for second, about in more.items():
            yield f"complete -c cloak -n '{there}' -f -a {second} -d {_quoted(about)}"
    for name, (_, options) in known.items():
        there = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in name.split())
        for flag, about in options.items():
            yield f"complete -c cloak -n '{there}' -l {flag.removeprefix('--')} -d {_quoted(about)}"


def _tree(known: Known) -> dict[str, dict[str, str]]:
    """Sort commands by their first words: each has its second words ("" for none), and what they do."""
    words: dict[str, dict[str, str]] = {"help": {"": "Show what a command does and takes"}}
    for name, (about, _) in known.items():
        first, _, second = name.partition(" ")
        words.setdefault(first, {})[second] = about
    return words


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


@dataclass(kw_only=True)
class Setup(Command):
    """Say what this trainer is; with --into, make an environment that has one, by pip."""

    example = "--into ~/cloak --source ."

    into: Path | None = None
    """New folder for the environment."""
    source: str = "cloak-core"
    """What pip installs there: a wheel, Cloak's sources, or a name of the package index."""
    share_torch: bool = False
    """Use this Python's torch and torchvision there, which spares 5 GB."""

    def run(self) -> dict:
        if self.into is None:
            return about()
        place = self.into.expanduser().absolute()
        make_environment(place, existing_source(self.source), self.share_torch)
        return {"program": str(place / SCRIPTS / PROGRAM), "python": python_in(place)}

    def show(self, result: dict) -> None:
        for name, value in result.items():
            out.print(f"{name:<8} {value}")


def about() -> dict:
    """Versions and device of this trainer, and where its program lies."""
    import torch

    named = torch.cuda.get_device_name(0) if torch.cuda.is_available() else f"CPU, {torch.get_num_threads()} threads"
    program = Path(sysconfig.get_path("scripts"), PROGRAM)
    return {
        "cloak": __version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "device": named,
        "program": str(program) if program.exists() else f"{sys.executable} -m cloak_core",
    }


def existing_source(source: str) -> str:
    """What pip is told to install; `InputError` for a path that is no wheel and no folder of sources."""
    path = Path(source).expanduser()
    if path.is_dir() and not (path / "pyproject.toml").is_file():
        raise InputError(f"--source {source}: does not hold Cloak's sources (no pyproject.toml in it)")
    if path.is_file() and not path.name.endswith((".whl", ".tar.gz")):
        raise InputError(f"--source {source}: neither a wheel (.whl) nor a folder of sources")
    if not path.exists() and re.search(r"[/\\]|\.whl$", source):
        raise InputError(f"--source {source}: no such file")
    return str(path.absolute()) if path.exists() else source


def make_environment(place: Path, source: str, share_torch: bool) -> None:
    """Make an environment and fill it; where that fails nothing of it is left. `InputError` says why."""
    require_new(place)
    if share_torch and not importlib.util.find_spec("torchvision"):
        raise InputError("--share-torch: this Python has no torchvision beside its torch")
    require_room(place.parent, GIGABYTES_WITHOUT_TORCH if share_torch else GIGABYTES)
    try:
        run_or_refuse([sys.executable, "-m", "venv", str(place)])
        if share_torch:
            torch_folder = importlib.util.find_spec("torch").submodule_search_locations[0]
            purelib = run_or_refuse([python_in(place), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"])
            write_text(Path(purelib.strip(), "torch.pth"), f"{Path(torch_folder).parent}\n")
        options = ["--no-input", "--disable-pip-version-check"]
        run_or_refuse([python_in(place), "-m", "pip", "install", *options, source])
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise


def python_in(place: Path) -> str:
    """The Python of an environment."""
    return str(place / SCRIPTS / PYTHON)


def require_room(folder: Path, gigabytes: float) -> None:
    """Raise `InputError` unless the folder is writable and its disk has room."""
    try:
        free = shutil.disk_usage(folder).free / 1e9
    except OSError as error:
        raise InputError(f"--into: {folder}: {error.strerror}") from None
    if not os.access(folder, os.W_OK):
        raise InputError(f"--into: {folder} cannot be written: no permission")
    if free < gigabytes:
        raise InputError(f"--into: {folder}: it takes about {gigabytes:.1f} GB, but {free:.1f} GB are free there")


def run_or_refuse(command: list[str]) -> str:
    """Run a command, its words on standard error as they come; `InputError` with what went wrong, and what to do."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    lines = []
    for line in process.stdout:
        lines.append(line)
        err.print(line.rstrip())
    output = "".join(lines)
    if process.wait():
        for pattern, words in _DIAGNOSES:
            if match := re.search(pattern, output):
                raise InputError(f"setup: {words.format(what=match.groupdict().get('what') or 'package')}")
        last = next((line.strip() for line in reversed(lines) if line.strip()), f"exit code {process.returncode}")
        raise InputError(f"setup: {last}")
    return output


_DIAGNOSES = (
    (r"No space left on device|Errno 28", "the disk is full: make room, or use --share-torch"),
    (r"ensurepip is not available|No module named '?(ensurepip|venv|pip)\b",
     "this Python has no pip: install it (on Debian and Ubuntu the package python3-venv)"),
    (r"CERTIFICATE_VERIFY_FAILED|SSLError", "the package index's certificate is not trusted: see pip's configuration"),
    (r"NewConnectionError|Max retries exceeded|ConnectTimeout|Temporary failure in name resolution|ProxyError",
     "the package index cannot be reached: check the network, the proxy and pip's configuration"),
    (r"requires a different Python", "this Python does not suit: use another"),
    (r"No matching distribution found for (?P<what>\S+)",
     "the package index has no suitable {what}: check pip's configuration (pip config list)"),
    (r"Permission denied|Errno 13", "the folder cannot be written: no permission"),
    (r"is not a supported wheel on this platform", "the wheel is for another system or Python"),
)  # fmt: skip
"""What pip says, and what to do."""
