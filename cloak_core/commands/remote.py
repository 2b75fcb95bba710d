"""`cloak remote`: run a command on another machine, with the files that its options name.

What it writes comes back: progress and colours every two seconds, everything else at the end. A file
`cancel` in the run folder, or SIGTERM, ends the command there in order.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import re
import shlex
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
import typing
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tyro.conf import Positional

from cloak_core.commands.base import Command, out
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.specs import split_spec
from cloak_core.files.writing import lock, require_new, write_text

LOOK_SECONDS = 2.0
UNREACHABLE = 255  # exit code, as ssh's own
LIVE = ("config.json", "material.npz", "logo.npy", "logo.json", "events.jsonl", "cloth.png", "colors.npy")
"""Of a run folder: what is fetched while it trains."""
OWN = (".lock", "cancel")
"""Of a run folder: what belongs to the machine it lies on."""
OUTPUTS = ("out", "events", "publish", "leaderboard", "junit", "directory", "to", "chart")
"""Options that name what is written. Every other path, and every text that names something, is read."""
PLAIN = (
    *("text", "name", "names", "about", "command", "licence", "region", "box", "kin"),
    *("device", "ray", "made_from", "only", "rungs", "zoo", "defence", "technique"),
)
"""Options of text that name no file, though one may be called so."""
SPECS = ("detector", "width_detector", "query_prior", "spec", "specs", "against", "judge")
"""Options that name detectors, which have files between colons: darknet:CFG:WEIGHTS@OPTIONS."""
COMPANIONS = {".xml": (".bin",), ".npy": (".json",), ".onnx": (".json", ".onnx.data", ".onnx_data")}
"""By the suffix of a file: the suffixes of files beside it that belong to it."""


@dataclass(kw_only=True)
class Remote(Command):
    """Run a command of cloak on another machine.

    The files that its options name are sent once, what it writes comes back. --save writes a program that does so with
    whatever it is given, for Blender to train with.
    """

    example = '--machine "ssh gpu-box" -- train --logo chest --out runs/first'

    machine: str
    """What runs a line of shell there: "ssh gpu-box"; "sh -c" for this machine."""
    folder: str = "/tmp/cloak"
    """Folder there for scenes and runs."""
    program: str = "cloak"
    """What starts cloak there: cloak, or python3 -m cloak_core."""
    save: Path | None = None
    """Write a program that has these options, and run nothing."""
    words: Positional[tuple[str, ...]] = ()
    """After --: the command, with its options."""

    def run(self) -> dict:
        if self.save is not None:
            return {"saved": str(self._save_launcher(self.save))}
        if not self.words:
            raise InputError("remote: name a command after -- (train --logo ...), or --save")
        if os.environ.get("CLOAK_OFFLINE"):
            raise InputError("remote: no network is allowed (in Blender: Preferences > System > Allow Online Access)")
        raise SystemExit(run_there(Machine(self.machine, self.folder), self.program, list(self.words)))

    def _save_launcher(self, path: Path) -> Path:
        """Write an executable program that runs its arguments by `cloak remote` with these options."""
        require_new(path)
        options = [f"--{name}={getattr(self, name)}" for name in ("machine", "folder", "program")]
        words = [sys.executable, "-m", "cloak_core", "remote", *options]
        if os.name == "nt":
            write_text(path, f"@{subprocess.list2cmdline(words)} -- %*\n")
        else:
            write_text(path, f'#!/bin/sh\nexec {shlex.join(words)} -- "$@"\n')
        path.chmod(0o755)
        return path

    def show(self, result: dict) -> None:
        out.print(f"wrote {result['saved']}: choose it as the trainer in Blender")


# --- what a command names ---------------------------------------------------------------------------------------------


def named_paths(command: Command) -> tuple[set[str], set[str]]:
    """The paths that a command's options name, as they are written: those it reads, and those it writes."""
    read, written = set(), set()
    for name, value in option_values(command):
        if name in OUTPUTS:
            written.add(str(value))
        elif isinstance(value, Path):
            read.add(str(value))
        elif name not in PLAIN:
            read.update(map(without_options, split_spec(value) if name in SPECS else [value]))
    return {path for path in read if path and os.path.exists(path)}, written - {"None", ""}


def option_values(options: object) -> Iterator[tuple[str, Path | str]]:
    """The names and values of paths and free texts among options, also of those that are grouped."""
    hints = typing.get_type_hints(type(options))
    for one in dataclasses.fields(options):
        value = getattr(options, one.name)
        if dataclasses.is_dataclass(value):
            yield from option_values(value)
        elif not _is_choice(hints[one.name]):
            parts = value if isinstance(value, tuple | list) else (value,)
            yield from ((one.name, part) for part in parts if isinstance(part, Path | str))


def _is_choice(kind: object) -> bool:
    return typing.get_origin(kind) is typing.Literal or any(map(_is_choice, typing.get_args(kind)))


def without_options(text: str) -> str:
    """FILE of FILE[PART] and FILE@OPTIONS; a file whose own name is so stays."""
    for path in (text, re.sub(r"\[[^\]]*\]$", "", text), text.rpartition("@")[0]):
        if path and os.path.exists(path):
            return path
    return text


def files_of(path: Path) -> dict[str, Path]:
    """The files to send for a path that an option names, links followed, by their names beside it."""
    if path.is_dir():
        walked = (Path(folder, name) for folder, _, names in os.walk(path, followlinks=True) for name in names)
        return {f.relative_to(path.parent).as_posix(): f for f in walked if f.name not in OWN and f.is_file()}
    beside = [path.with_suffix(suffix) for suffix in COMPANIONS.get(path.suffix.lower(), ())]
    return {file.name: file for file in (path, *beside) if file.is_file()} | pictures_of(path)


def pictures_of(path: Path) -> dict[str, Path]:
    """The pictures beside a COCO file of people, which it names."""
    if path.suffix.lower() != ".json":
        return {}
    try:
        names = [str(image["file_name"]) for image in read_json(path)["images"]]
    except (InputError, KeyError, TypeError):  # another kind of file
        return {}
    inside = [name for name in names if ".." not in Path(name).parts]
    return {name: path.parent / name for name in inside if (path.parent / name).is_file()}


# --- the other machine ------------------------------------------------------------------------------------------------


@dataclass
class Machine:
    """Another machine, behind a prefix that runs a line of shell there."""

    prefix: str
    folder: str
    there: dict[str, str] = field(default_factory=dict)  # where paths of this machine lie over there

    def start(self, line: str, **streams: object) -> subprocess.Popen:
        """Start a line of shell over there."""
        return subprocess.Popen([*shlex.split(self.prefix), line], **streams)

    def do(self, line: str) -> int:
        """Run a line of shell over there and return its exit code."""
        return self.start(line, stdin=subprocess.DEVNULL).wait()

    def send(self, path: Path) -> str:
        """Send what a path names unless an unchanged copy is there; return its path over there."""
        files = files_of(path)
        look = [f"{name} {file} {file.stat().st_size} {file.stat().st_mtime_ns}" for name, file in files.items()]
        place = f"{self.folder}/{digest(str(path), *look)}"
        goal = shlex.quote(place)
        if self.do(f"test -e {goal}/.complete") != 0:
            process = self.start(f"mkdir -p {goal} && tar -C {goal} -xf - && touch {goal}/.complete", stdin=-1)
            with tarfile.open(fileobj=process.stdin, mode="w|", dereference=True) as archive:
                for name, file in files.items():
                    archive.add(file, plain(name))
            process.stdin.close()
            if process.wait() != 0:
                raise InputError(f"{', '.join(files)}: cannot be sent to {self.folder}")
        return f"{place}/{plain(path.name)}"

    def fetch(self, remote: str, local: Path, names: tuple[str, ...] = ()) -> None:
        """Bring a file or folder back (of a folder only some names); each file is replaced at once."""
        local.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=local.parent, prefix=".cloak ") as temporary:
            self._unpack(remote, names, temporary)
            for file in [p for p in Path(temporary).rglob("*") if p.is_file() and p.name not in OWN]:
                place = local.joinpath(*file.relative_to(temporary).parts[1:])
                place.parent.mkdir(parents=True, exist_ok=True)
                os.replace(file, place)

    def _unpack(self, remote: str, names: tuple[str, ...], temporary: str) -> None:
        folder, name = os.path.split(remote)
        parts = " ".join(shlex.quote(f"{name}/{part}") for part in names) if names else shlex.quote(name)
        line = f"cd {shlex.quote(folder)} 2>/dev/null && tar -cf - $(ls -d {parts} 2>/dev/null)"
        process = self.start(line, stdin=subprocess.DEVNULL, stdout=-1, stderr=subprocess.DEVNULL)
        with (
            contextlib.suppress(tarfile.ReadError),  # nothing there yet
            tarfile.open(fileobj=process.stdout, mode="r|") as archive,
        ):
            # Filters are there from CPython 3.11.4 on; Debian 12 has 3.11.2.
            safely = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
            for member in archive:
                inside = Path(temporary, member.name).resolve().is_relative_to(Path(temporary).resolve())
                if not inside or not (member.isreg() or member.isdir()):
                    raise InputError(f"{self.prefix}: sent {member.name!r}, which is no file or folder of {name}")
                archive.extract(member, temporary, **safely)
        process.stdout.read()
        process.wait()


def plain(name: str) -> str:
    """A file's name, with its folders, as no shell has trouble with it."""
    return re.sub(r"[^A-Za-z0-9._/-]", "_", name)


def digest(*words: str) -> str:
    """A short name for what these words say."""
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:16]


def run_there(machine: Machine, program: str, words: list[str]) -> int:
    """Send, run, fetch; the command's own exit code, or `UNREACHABLE`."""
    from cloak_core import cli

    command = cli.parse(*cli.find(words))
    read, written = named_paths(command)
    folder = shlex.quote(machine.folder)
    if machine.do(f"mkdir -p {folder}") != 0:
        sys.stderr.write(f"cloak: {machine.prefix}: cannot be reached, or {machine.folder} not made there\n")
        return UNREACHABLE
    outputs = prepare(machine, read, written, str(getattr(command, "run_folder", "")))
    pid = f"{folder}/{os.getpid()}.pid"
    line = shlex.join([*shlex.split(program), *(translated(word, machine.there) for word in words)])
    environment = "unset PYTHONPATH PYTHONHOME; export PYTHONUNBUFFERED=1 PYTHONSAFEPATH=1"
    shell = f"cd {folder} && echo $$ > {pid} && {environment} && exec {line}"
    process = machine.start(shell, stdin=subprocess.DEVNULL, stdout=-1)
    run = Path(command.out) if words[0] == "train" else None
    follow(machine, process, outputs, run, pid)
    answer = process.stdout.read().decode("utf-8", "replace")
    for local, target in outputs.items():
        machine.fetch(target, local)
    if run is not None:
        (run / "cancel").unlink(missing_ok=True)
    for local, target in machine.there.items():
        answer = answer.replace(target, local)
    sys.stdout.write(answer)
    sys.stdout.flush()
    return process.returncode


def prepare(machine: Machine, read: set[str], written: set[str], judged: str) -> dict[Path, str]:
    """Send what is read, and make room for what is written; the outputs here, and over there.

    judged: a run folder into which the command writes what it finds out about it; "" for none.
    """
    outputs: dict[Path, str] = {}
    for path in sorted(read):
        machine.there[path] = machine.send(Path(path).absolute())
        if path == judged:
            outputs[Path(path)] = machine.there[path]
    for path in sorted(written):
        local = Path(path).absolute()
        target = f"{machine.folder}/out-{digest(str(local))}/{plain(local.name)}"
        machine.do(f"mkdir -p {shlex.quote(os.path.dirname(target))}")
        if local.is_dir():  # to be resumed
            sent, goal = shlex.quote(machine.send(local)), shlex.quote(target)
            machine.do(f"rm -rf {goal} && cp -r {sent} {goal}")
        machine.there[path] = outputs[Path(path)] = target
    return outputs


def translated(word: str, there: dict[str, str]) -> str:
    """A word of the command with the paths that its options name as they are over there, the longest first."""
    option, _, value = word.partition("=") if word.startswith("--") else ("", "", word)
    for path in sorted(there, key=len, reverse=True):
        spellings = {path, str(Path(path))}
        for part in [value, *split_spec(value)]:
            bare = without_options(part)
            if bare in spellings or str(Path(bare)) in spellings:
                return f"{option}=" * bool(option) + value.replace(bare, there[path], 1)
    return word


def follow(machine: Machine, process: subprocess.Popen, outputs: dict[Path, str], run: Path | None, pid: str) -> None:
    """Bring back progress until the process over there ends, and hand on that it shall stop."""
    stops: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: stops.append(1))
    with contextlib.ExitStack() as held:
        holds = False
        while process.poll() is None:
            time.sleep(LOOK_SECONDS / 4 if stops else LOOK_SECONDS)
            for local, target in outputs.items():
                if local == run or local.suffix == ".jsonl":  # a run that grows, or a file of events
                    machine.fetch(target, local, LIVE if local == run else ())
            if run is not None and run.is_dir() and not holds:
                with contextlib.suppress(BlockingIOError):
                    held.enter_context(lock(run / ".lock"))  # so that the folder counts as being trained
                holds = True
            if run is not None and ((run / "cancel").exists() or stops):
                machine.do(f"touch {shlex.quote(outputs[run])}/cancel")
            elif stops:
                machine.do(f"kill $(cat {pid})")
