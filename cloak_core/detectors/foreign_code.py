"""Users' code in our process.

What it raises becomes one line of theirs, as does that it gives no answer; what it changes of the process is set back,
and the files it reads are known.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import os
import random
import re
import signal
import sys
import threading
import traceback
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from cloak_core.files.errors import InputError, first_line
from cloak_core.files.identity import imported_files
from cloak_core.files.reading import MAX_TEXT_BYTES, read_bytes

MAX_DATA_BYTES = 64 << 20
"""Of one file of data beside the code that counts for what a detector is; weights are hashed as tensors anyway."""
MOST_SECONDS = 600.0
"""Of loading a user's code, and of each call, unless the variable CLOAK_DETECTOR_SECONDS says otherwise (0: none)."""
_SUFFIX = re.compile(r"\.\w{1,16}\Z")
_loaded: dict[str, str] = {}
_opened: dict[Path, set[Path]] = defaultdict(set)
_watching = threading.local()


class NoAnswer(BaseException):
    """Code of a user's took too long: no `Exception`, so that their own `except Exception` does not go on."""


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """Raise `NoAnswer` where the block still runs after `MOST_SECONDS`. InputError: the variable is no number.

    Python code and waits (sleep, locks, sockets) are interrupted; native code is not before it returns. Threads beside
    the main one, Windows, and a process whose alarm somebody else has set are left without a limit.
    """
    text = os.environ.get("CLOAK_DETECTOR_SECONDS", str(MOST_SECONDS))
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds < threading.TIMEOUT_MAX:
        raise InputError(f"CLOAK_DETECTOR_SECONDS: {text!r} is no number of seconds")
    is_ours = threading.current_thread() is threading.main_thread() and hasattr(signal, "setitimer")
    if not seconds or not is_ours or any(signal.getitimer(signal.ITIMER_REAL)):
        yield
        return

    def late(*_: object) -> None:
        raise NoAnswer(f"no answer in {seconds:g} s (the variable CLOAK_DETECTOR_SECONDS allows more)")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def excused(spec: str, file: Path | None) -> Iterator[None]:
    """Turn whatever the user's code raises, or its leaving the process, into an InputError with the line of their file.

    Only a keyboard's interrupt and memory that is full pass as they are: these are not the code's doing.
    """
    if file is not None:
        _loaded[str(file)] = spec
    try:
        yield
    except (InputError, MemoryError, KeyboardInterrupt):
        raise
    except BaseException as error:
        if type(error).__name__ == "OutOfMemoryError":  # torch's
            raise
        raise InputError(_words(spec, str(file), error)) from error


@contextlib.contextmanager
def set_back(signals: bool = False) -> Iterator[None]:
    """Set back what the block changes of the process: modes, folder, streams, path, warnings, random numbers.

    Inference scripts set such things when they are imported, and we and other detectors would then compute otherwise,
    or write elsewhere. signals: also who hears Ctrl-C and the request to end, which only the main thread may change.
    """
    kept = [*_KEPT, *(_SIGNALS if signals and threading.current_thread() is threading.main_thread() else ())]
    before = [read() for read, _ in kept]
    seeds = torch.get_rng_state(), np.random.get_state(), random.getstate()
    path, raising, folder = [*sys.path], _raising(), None
    with contextlib.suppress(OSError):  # somebody has removed it
        folder = os.getcwd()
    try:
        with contextlib.redirect_stdout(sys.stdout), contextlib.redirect_stderr(sys.stderr), np.errstate():
            yield
    finally:
        for (read, write), value in zip(kept, before, strict=True):
            if read() != value:
                write(value)
        if folder is not None:
            os.chdir(folder)
        # What was added stays at the end: the code may import more when it is called, and hides nothing of ours there.
        sys.path[:] = path + [place for place in sys.path if place not in path]
        if (added := _raising()) != raising:
            warnings.filters[:] = [rule for rule in warnings.filters if rule not in added or rule in raising]
        _reseed(*seeds)


def _raising() -> list[tuple]:
    """List the filters that make warnings errors."""
    return [rule for rule in warnings.filters if rule[0] == "error"]


def _reseed(of_torch: Tensor, of_numpy: tuple, of_python: tuple) -> None:
    """Set back the global random states that were drawn from or seeded, one draw on: the next call draws others."""
    if not torch.equal(torch.get_rng_state(), of_torch):
        torch.set_rng_state(of_torch)
        torch.rand(1, device="cpu")
    now = np.random.get_state()
    if now[2:] != of_numpy[2:] or not np.array_equal(now[1], of_numpy[1]):
        np.random.set_state(of_numpy)
        np.random.random()
    if random.getstate() != of_python:
        random.setstate(of_python)
        random.random()


def _set_inference(on: bool) -> None:
    mode = torch.inference_mode(on)
    mode.__enter__()
    _entered.append(mode)  # it ends with its object


def _set_device(device: torch.device) -> None:
    # Torch looks at every call where a default is set; the CPU is so without.
    torch.set_default_device(None if device.type == "cpu" else device)


_entered: list[torch.inference_mode] = []
_KEPT: tuple[tuple[Callable[[], object], Callable[..., object]], ...] = (
    (torch.is_inference_mode_enabled, _set_inference),
    (torch.is_grad_enabled, torch.set_grad_enabled),
    (torch.get_default_dtype, torch.set_default_dtype),
    (torch.get_default_device, _set_device),
    (torch.get_num_threads, torch.set_num_threads),
    (torch.are_deterministic_algorithms_enabled, torch.use_deterministic_algorithms),
    (lambda: torch.is_autocast_enabled("cpu"), lambda on: torch.set_autocast_enabled("cpu", on)),
)
"""Modes that are set back: how each is read, and written. Inference mode comes first: it changes that of gradients."""
_SIGNALS = tuple(
    (functools.partial(signal.getsignal, number), functools.partial(signal.signal, number))
    for number in (signal.SIGINT, signal.SIGTERM)
)


def culprit(error: BaseException) -> str | None:
    """Explain an error that went through a user's file (a backward pass calls it unasked); None for others."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.filename in _loaded:
            return _words(_loaded[frame.filename], frame.filename, error)
    return None


def _words(spec: str, file: str, error: BaseException) -> str:
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    if isinstance(error, SyntaxError) and error.filename == file:
        lines.append(error.lineno)
    place = f"{file}:{lines[-1]}: " if lines else ""
    if isinstance(error, NoAnswer):
        return f"{spec}: {place}{error}"
    words = f"it ends the process with {error.code}" if isinstance(error, SystemExit) else first_line(error)
    return f"{spec}: {place}{type(error).__name__}: {words}"


@contextlib.contextmanager
def watched(file: Path) -> Iterator[None]:
    """Remember which files beside `file` the block opens for reading: see `data_beside`."""
    _listen()
    _watching.paths = paths = []
    try:
        yield
    finally:
        del _watching.paths
        folder = file.resolve().parent
        files = {Path(os.path.realpath(path)) for path in paths}
        _opened[file.resolve()] |= {path for path in files if folder in path.parents}


def data_beside(file: Path) -> dict[str, str]:
    """Hash (SHA-256, hex) each data file in a Python file's folder that the code reads, by its place there.

    Counted are files that were opened while it was loaded, and files that its source (or what it imports from there)
    names in a text: `open(HERE / "anchors.json")`, `Path(__file__).with_suffix(".json")`.
    """
    folder, file = file.resolve().parent, file.resolve()
    sources = set(imported_files(file).values())
    data_files = {path for path in _opened[file] | set(_named(file, sources)) if path not in sources}
    data = {}
    for path in sorted(data_files):
        if path.suffix in (".py", ".pyc") or not path.is_file() or path.stat().st_size > MAX_DATA_BYTES:
            continue
        data[path.relative_to(folder).as_posix()] = hashlib.sha256(read_bytes(path, MAX_DATA_BYTES)).hexdigest()
    return data


def _named(file: Path, sources: set[Path]) -> Iterator[Path]:
    """Find files below the folder that strings in the sources name, in it or in folders that they name."""
    texts = set()
    for source in sources:
        with contextlib.suppress(SyntaxError, ValueError):  # whoever runs it will say so
            nodes = ast.walk(ast.parse(read_bytes(source, MAX_TEXT_BYTES)))
            texts |= {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    texts = {text for text in texts if len(text) < 256 and text.isprintable() and text.strip("./")}
    folders = [file.parent]
    for folder in folders:  # grows by the folders that are named, up to a depth
        if len(folder.relative_to(file.parent).parts) < 3:
            folders += [folder / text for text in sorted(texts) if "/" not in text and (folder / text).is_dir()]
    for text in texts:
        places = [folder / text for folder in folders]
        places += [file.with_suffix(text)] if _SUFFIX.match(text) else []
        for path in places:
            if file.parent in Path(os.path.normpath(path)).parents and path.is_file():
                yield path


@functools.cache
def _listen() -> None:
    """Have Python report every file that is opened, from now on: it cannot be asked to stop."""
    sys.addaudithook(_hear)


def _hear(event: str, arguments: tuple) -> None:
    paths = getattr(_watching, "paths", None) if event == "open" else None
    if paths is None or not isinstance(arguments[0], (str, bytes)):
        return
    path, mode, flags = arguments
    writes = set(mode or "") & set("wax+") or (flags or 0) & (os.O_WRONLY | os.O_RDWR)
    if not writes:
        paths.append(os.path.abspath(os.fsdecode(path)))
