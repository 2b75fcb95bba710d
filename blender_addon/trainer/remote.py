# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the trainer on another machine: `python remote.py PREFIX FOLDER SHARED PYTHON WORD ...`, a program of its own.

PREFIX is what runs a line of shell over there (`ssh box`; `sh -c` for this machine), FOLDER a folder there, PYTHON the
Python there that has cloak_core. SHARED is FOLDER as this machine sees it; "" sends files through PREFIX instead.
Files that the words name are sent once, unless they changed since; what is written comes back: progress and colours
every two seconds, everything at the end. A file `cancel` in the run folder, or SIGTERM, ends the run in order. The
exit code is the trainer's; 255: the machine cannot be reached.

Plain Python, no Blender: it outlives neither, and holds the run's lock as a trainer on this machine would.
"""

import contextlib
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
from pathlib import Path

LOOK_SECONDS = 2.0
LIVE = ("config.json", "logo.npy", "logo.json", "events.jsonl", "colors.npy")
"""Of a run folder: what is fetched while it trains."""
OWN = (".lock", "cancel")  # of a run folder: what is not fetched
_PART = re.compile(r"[^:=]+")


class Remote:
    """Another machine, behind a prefix that runs a line of shell there, and perhaps a folder that it shares."""

    def __init__(self, prefix: str, folder: str, shared: str = "") -> None:
        self.prefix, self.folder, self.shared = shlex.split(prefix), folder.rstrip("/"), shared
        self.paths: dict[str, str] = {}  # where local paths lie over there

    def start(self, line: str, **streams: object) -> subprocess.Popen:
        """A line of shell over there."""
        return subprocess.Popen([*self.prefix, line], **streams)

    def do(self, line: str) -> int:
        """Run a line of shell over there and return its exit code."""
        return self.start(line, stdin=subprocess.DEVNULL).wait()

    def here(self, remote: str) -> Path:
        """A path over there as this machine sees it in the shared folder."""
        return Path(self.shared, os.path.relpath(remote, self.folder))

    def send(self, path: Path) -> str:
        """Send a file or folder unless an unchanged copy is there; return its remote path."""
        # Of a file also what belongs to it by its name: weights of an .xml, a description of an .onnx.
        found = path.rglob("*") if path.is_dir() else path.parent.glob(f"{path.stem}.*")
        files = sorted(p for p in found if p.is_file() and p.name not in OWN)
        look = [f"{p} {p.stat().st_size} {p.stat().st_mtime_ns}" for p in files]
        place = f"{self.folder}/{hashlib.sha256(chr(10).join([str(path), *look]).encode()).hexdigest()[:16]}"
        names = {}
        for file in files:
            first, *rest = file.relative_to(path.parent).parts
            names["/".join([plain(first), *rest])] = file
        (self._copy if self.shared else self._pipe)(names, place)
        target = self.paths[str(path)] = f"{place}/{plain(path.name)}"
        return target

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
        with tarfile.open(fileobj=process.stdin, mode="w|") as archive:
            for name, file in names.items():
                archive.add(file, name)
        process.stdin.close()
        if process.wait() != 0:
            raise OSError(f"{', '.join(names)}: cannot be sent to {self.folder}")

    def replace(self, source: str, target: str) -> None:
        """Copy a folder over there."""
        source, target, folder = map(shlex.quote, (source, target, os.path.dirname(target)))
        self.do(f"rm -rf {target} && mkdir -p {folder} && cp -r {source} {target}")

    def fetch(self, remote: str, local: Path, names: tuple[str, ...] = ()) -> bool:
        """Bring a file or folder back (of a folder only some names); each file is replaced at once."""
        local.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=local.parent, prefix=".cloak ") as temporary:
            (self._copy_back if self.shared else self._pipe_back)(remote, names, temporary)
            came = [p for p in Path(temporary).rglob("*") if p.is_file() and p.name not in OWN]
            for file in came:
                _, *rest = file.relative_to(temporary).parts
                place = local.joinpath(*rest)
                place.parent.mkdir(parents=True, exist_ok=True)
                os.replace(file, place)
        return bool(came)

    def _copy_back(self, remote: str, names: tuple[str, ...], temporary: str) -> None:
        source = self.here(remote)
        found = [source / name for name in names] or [source, *source.rglob("*")]
        for file in (path for path in found if path.is_file()):
            place = temporary / file.relative_to(source.parent)
            place.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileNotFoundError):  # a temporary file of the trainer's
                shutil.copyfile(file, place)

    def _pipe_back(self, remote: str, names: tuple[str, ...], temporary: str) -> None:
        folder, name = os.path.split(remote)
        wanted = " ".join(shlex.quote(f"{name}/{n}") for n in names) if names else shlex.quote(name)
        line = f"cd {shlex.quote(folder)} 2>/dev/null && tar -cf - $(ls -d {wanted} 2>/dev/null)"
        process = self.start(line, stdin=subprocess.DEVNULL, stdout=-1, stderr=subprocess.DEVNULL)
        with (
            contextlib.suppress(tarfile.ReadError),  # nothing there yet
            tarfile.open(fileobj=process.stdout, mode="r|") as archive,
        ):
            archive.extractall(temporary, filter="data")
        process.stdout.read()
        process.wait()


def plain(name: str) -> str:
    """A file's name as no shell has trouble with it."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", name)


def translated(remote: Remote, words: list[str]) -> tuple[list[str], list[tuple[Path, str]]]:
    """The words with paths of over there, and what is written: local and remote paths."""
    made: list[str] = []
    written: list[tuple[Path, str]] = []
    for place, word in enumerate(words):
        option, value = word.partition("=")[::2] if word.startswith("--") else ("", word)
        option = option if option in ("--out", "--events") else words[place - 1] if place else ""
        path = Path(value)
        if path.is_absolute() and option in ("--out", "--events"):
            target = f"{remote.folder}/out-{hashlib.sha256(value.encode()).hexdigest()[:16]}/{plain(path.name)}"
            written.append((path, target))
            if path.is_dir():  # to be resumed
                remote.replace(remote.send(path), target)
            remote.paths[value] = target
            remote.do(f"mkdir -p {shlex.quote(os.path.dirname(target))}")
            made.append(word.replace(value, target))
        elif path.is_absolute() and path.is_dir() and (path / "config.json").is_file():
            made.append(word.replace(value, remote.send(path)))  # a run that is judged: what is found out lies in it
            written.append((path, remote.paths[value]))
        else:
            made.append(_PART.sub(lambda part: _sent(remote, part.group()), word))
    return made, written


def _sent(remote: Remote, part: str) -> str:
    """A part of a word; a path that is there as one of over there, with the options behind its @."""
    for path in (part, part.rpartition("@")[0]):
        if path and Path(path).is_absolute() and Path(path).exists():
            return remote.send(Path(path)) + part[len(path) :]
    return part


def main(prefix: str, folder: str, shared: str, python: str, *words: str) -> int:
    """Send, run, fetch."""
    remote = Remote(prefix, folder, shared)
    if shared and not Path(shared).is_dir():
        print(f"cloak: {shared}: the shared folder is not there", file=sys.stderr)
        return 255
    if remote.do(f"mkdir -p {shlex.quote(remote.folder)}") != 0:
        print(f"cloak: {prefix}: the other machine cannot be reached, or {folder} not made there", file=sys.stderr)
        return 255
    arguments, written = translated(remote, list(words))
    run = next((path for path, _ in written if "train" in words and "--out" in " ".join(words)), None)
    pid = f"{remote.folder}/{os.getpid()}.pid"
    line = " ".join(map(shlex.quote, [python, *arguments]))
    environment = "unset PYTHONPATH PYTHONHOME; PYTHONUNBUFFERED=1 PYTHONSAFEPATH=1"
    shell = f"cd {shlex.quote(remote.folder)} && echo $$ > {shlex.quote(pid)} && {environment} exec {line}"
    process = remote.start(shell, stdin=subprocess.DEVNULL, stdout=-1)
    asked: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: asked.append(1))
    held = None
    while process.poll() is None:
        time.sleep(LOOK_SECONDS / 4 if asked else LOOK_SECONDS)
        for local, target in written:
            if local == run or local.suffix:  # a run that grows, or a file of events
                remote.fetch(target, local, LIVE if local == run else ())
        if run is not None and held is None and run.is_dir():
            held = _hold(run)
        if run is not None and ((run / "cancel").exists() or asked):
            remote.do(f"touch {shlex.quote(remote.paths[str(run)])}/cancel")
        elif asked:
            remote.do(f"kill $(cat {shlex.quote(pid)})")
    said = process.stdout.read().decode("utf-8", "replace")
    for local, target in written:
        remote.fetch(target, local)
    if run is not None:
        with contextlib.suppress(FileNotFoundError):
            (run / "cancel").unlink()
    for local, target in remote.paths.items():
        said = said.replace(target, local)
    sys.stdout.write(said)
    return process.returncode


def _hold(run: Path) -> object:
    """Hold the run's lock, so that the folder counts as being trained."""
    if os.name != "posix":
        return True
    import fcntl

    file = (run / ".lock").open("a")
    with contextlib.suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return file


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
