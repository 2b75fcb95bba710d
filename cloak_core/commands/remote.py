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
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tyro.conf import Positional

from cloak_core.commands.base import Command, out, require_new
from cloak_core.files.errors import InputError
from cloak_core.files.locks import lock
from cloak_core.files.reading import read_json
from cloak_core.files.specs import split_spec
from cloak_core.files.writing import write_text

LOOK_SECONDS = 2.0
UNREACHABLE = 255  # exit code, as ssh's own
LIVE = ("config.json", "material.npz", "logo.npy", "logo.json", "events.jsonl", "cloth.png", "colors.npy")
"""Of a run folder: what is fetched while it trains."""
OWN = (".lock", "cancel")
"""Of a run folder: what belongs to the machine it lies on."""
OUTPUTS = ("out", "events", "publish", "leaderboard", "junit", "directory")
"""Options that name what is written."""
DETECTORS = ("detector", "spec", "specs", "against", "judge", "unseen")
"""Options that name detectors, in specs such as darknet:CFG:WEIGHTS@OPTIONS."""
PLACES = (
    *("scene", "backgrounds", "unseen_backgrounds", "people", "photos", "colors", "patterns", "cloak", "init", "near"),
    *("palette", "profile", "query_prior", "source", "target", "camera", "logo"),
)
"""Other options of text that may name a file or folder; FILE[PART] and FILE@OPTIONS are spelled so."""
COMPANIONS = {".xml": (".bin",), ".npy": (".json",), ".onnx": (".json", ".onnx.data", ".onnx_data")}
"""By the suffix of a file: the suffixes of files beside it that belong to it."""


@dataclass(kw_only=True)
class Remote(Command):
    """Run a command of cloak on another machine.

    The files that the command's options name are sent once, links followed, nothing else; what it writes comes back.
    With --save, a program is written that does so with whatever it is given, for Blender to train with.
    """

    example = '--machine "ssh gpu-box" -- train --logo chest --out runs/first'

    machine: str
    """What runs a line of shell over there: "ssh gpu-box"; "sh -c" for this machine."""
    folder: str = "/tmp/cloak"
    """A folder over there for scenes and runs."""
    shared: Path | None = None
    """That folder as this machine sees it, where they share it; otherwise files go through the machine's command."""
    program: str = "cloak"
    """What starts cloak over there: cloak, or python3 -m cloak_core."""
    save: Path | None = None
    """Write a program here that stands for these options, instead of running a command."""
    words: Positional[tuple[str, ...]] = ()
    """After --: the command, with its options."""

    def run(self) -> dict:
        if self.save is not None:
            return {"saved": str(save_launcher(self))}
        if not self.words:
            raise InputError("remote: name a command after -- (train --logo ...), or --save")
        if os.environ.get("CLOAK_OFFLINE"):
            raise InputError("remote: no network is allowed (in Blender: Preferences > System > Allow Online Access)")
        raise SystemExit(run_there(Machine(self.machine, self.folder, self.shared), self.program, list(self.words)))

    def show(self, result: dict) -> None:
        out.print(f"wrote {result['saved']}: choose it as the trainer in Blender")


def save_launcher(options: Remote) -> Path:
    """Write an executable program that runs its arguments by `cloak remote` with these options."""
    require_new(options.save)
    named = {"machine": options.machine, "folder": options.folder, "program": options.program}
    named |= {"shared": str(options.shared)} if options.shared else {}
    words = [sys.executable, "-m", "cloak_core", "remote", *(f"--{name}={value}" for name, value in named.items())]
    if os.name == "nt":
        text = f"@{subprocess.list2cmdline(words)} -- %*\n"
    else:
        text = f'#!/bin/sh\nexec {shlex.join(words)} -- "$@"\n'
    write_text(options.save, text)
    options.save.chmod(0o755)
    return options.save


# --- what a command names ---------------------------------------------------------------------------------------------


def named_paths(command: Command) -> tuple[set[str], set[str]]:
    """The paths that a command's options name, as they are written: those it reads, and those it writes."""
    read, written = set(), set()
    for name, value in option_values(command):
        if name in OUTPUTS:
            written.add(str(value))
        elif isinstance(value, Path):
            read.add(str(value))
        elif name in DETECTORS:
            read.update(map(without_options, split_spec(value)))
        elif name in PLACES:
            read.add(without_options(value))
    return {path for path in read if path and os.path.exists(path)}, written - {"None", ""}


def option_values(options: object) -> Iterator[tuple[str, Path | str]]:
    """The names and values of paths and texts among options, also of those that are grouped."""
    for one in dataclasses.fields(options):
        value = getattr(options, one.name)
        if dataclasses.is_dataclass(value):
            yield from option_values(value)
        for part in value if isinstance(value, tuple | list) else (value,):
            if isinstance(part, Path | str):
                yield one.name, part


def without_options(text: str) -> str:
    """FILE of FILE[PART] and FILE@OPTIONS; a file whose own name is so stays."""
    for path in (text, re.sub(r"\[[^\]]*\]$", "", text), text.rpartition("@")[0]):
        if path and os.path.exists(path):
            return path
    return text


def files_of(path: Path) -> dict[str, Path]:
    """The files to send for a path that an option names, links followed, by their names beside it."""
    if path.is_dir():
        found: dict[str, Path] = {}
        for folder, _, names in os.walk(path, followlinks=True):
            for name in names:
                file = Path(folder, name)
                if name not in OWN and file.is_file():
                    found[file.relative_to(path.parent).as_posix()] = file
        return found
    beside = [path.with_suffix(suffix) for suffix in COMPANIONS.get(path.suffix.lower(), ())]
    files = {file.name: file for file in (path, *beside) if file.is_file()}
    return files | pictures_of(path)


def pictures_of(path: Path) -> dict[str, Path]:
    """The pictures beside a COCO file of people, which it names."""
    if path.suffix.lower() != ".json":
        return {}
    try:
        names = [str(image["file_name"]) for image in read_json(path)["images"]]
    except (InputError, KeyError, TypeError):  # another kind of file
        return {}
    return {
        name: path.parent / name for name in names if ".." not in Path(name).parts and (path.parent / name).is_file()
    }


# --- the other machine ------------------------------------------------------------------------------------------------


@dataclass
class Machine:
    """Another machine, behind a prefix that runs a line of shell there, and perhaps a folder that it shares."""

    prefix: str
    folder: str
    shared: Path | None = None
    there: dict[str, str] = field(default_factory=dict)  # where paths of this machine lie over there

    def start(self, line: str, **streams: object) -> subprocess.Popen:
        """Start a line of shell over there."""
        return subprocess.Popen([*shlex.split(self.prefix), line], **streams)

    def do(self, line: str) -> int:
        """Run a line of shell over there and return its exit code."""
        return self.start(line, stdin=subprocess.DEVNULL).wait()

    def here(self, remote: str) -> Path:
        """A path over there as this machine sees it in the shared folder."""
        return Path(self.shared, os.path.relpath(remote, self.folder))

    def send(self, path: Path) -> str:
        """Send what a path names unless an unchanged copy is there; return its path over there."""
        files = files_of(path)
        look = [f"{name} {file} {file.stat().st_size} {file.stat().st_mtime_ns}" for name, file in files.items()]
        place = f"{self.folder}/{digest(str(path), *look)}"
        names = {plain(name): file for name, file in files.items()}
        (self._copy if self.shared else self._pipe)(names, place)
        return f"{place}/{plain(path.name)}"

    def _copy(self, names: dict[str, Path], place: str) -> None:
        goal = self.here(place)
        if not (goal / ".complete").exists():
            for name, file in names.items():
                (goal / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, goal / name)
            (goal / ".complete").touch()

    def _pipe(self, names: dict[str, Path], place: str) -> None:
        place = shlex.quote(place)
        if self.do(f"test -e {place}/.complete") == 0:
            return
        process = self.start(f"mkdir -p {place} && tar -C {place} -xf - && touch {place}/.complete", stdin=-1)
        with tarfile.open(fileobj=process.stdin, mode="w|", dereference=True) as archive:
            for name, file in names.items():
                archive.add(file, name)
        process.stdin.close()
        if process.wait() != 0:
            raise InputError(f"{', '.join(names)}: cannot be sent to {self.folder}")

    def fetch(self, remote: str, local: Path, names: tuple[str, ...] = ()) -> None:
        """Bring a file or folder back (of a folder only some names); each file is replaced at once."""
        local.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=local.parent, prefix=".cloak ") as temporary:
            (self._copy_back if self.shared else self._pipe_back)(remote, names, temporary)
            for file in [p for p in Path(temporary).rglob("*") if p.is_file() and p.name not in OWN]:
                place = local.joinpath(*file.relative_to(temporary).parts[1:])
                place.parent.mkdir(parents=True, exist_ok=True)
                os.replace(file, place)

    def _copy_back(self, remote: str, names: tuple[str, ...], temporary: str) -> None:
        source = self.here(remote)
        files = [source / name for name in names] or [source, *source.rglob("*")]
        for file in (path for path in files if path.is_file()):
            place = temporary / file.relative_to(source.parent)
            place.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileNotFoundError):  # a temporary file of the trainer's
                shutil.copyfile(file, place)

    def _pipe_back(self, remote: str, names: tuple[str, ...], temporary: str) -> None:
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
    if machine.shared and not machine.shared.is_dir():
        return unreachable(f"{machine.shared}: the shared folder is not there")
    if machine.do(f"mkdir -p {shlex.quote(machine.folder)}") != 0:
        return unreachable(f"{machine.prefix}: cannot be reached, or {machine.folder} not made there")
    outputs = prepare(machine, read, written, str(getattr(command, "run_folder", "")))
    pid = f"{machine.folder}/{os.getpid()}.pid"
    line = " ".join(map(shlex.quote, [*shlex.split(program), *(translated(word, machine.there) for word in words)]))
    environment = "unset PYTHONPATH PYTHONHOME; export PYTHONUNBUFFERED=1 PYTHONSAFEPATH=1"
    shell = f"cd {shlex.quote(machine.folder)} && echo $$ > {shlex.quote(pid)} && {environment} && exec {line}"
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


def unreachable(reason: str) -> int:
    """Say why the other machine cannot be used."""
    sys.stderr.write(f"cloak: {reason}\n")
    return UNREACHABLE


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
                machine.do(f"kill $(cat {shlex.quote(pid)})")
