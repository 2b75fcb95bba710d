"""Standard output and error: open whatever the caller left closed, whole in any encoding, one line for each message."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import sys
import warnings
from collections.abc import Iterator

from cloak_core.files.errors import InputError, one_line

ABSENT: set[str] = set()
"""Which of "stdout" and "stderr" the caller closed, or never opened."""


class Forgiving(io.TextIOWrapper):
    """Standard error: where it cannot be written (a full disk, a closed pipe), words are lost and work goes on."""

    def write(self, s: str) -> int:
        with contextlib.suppress(OSError):
            super().write(s)
        return len(s)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            super().flush()


def prepare_streams() -> None:
    """Write characters that a terminal lacks as escapes, and each message of a library as one line."""
    _open_what_is_closed()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    if type(sys.stderr) is io.TextIOWrapper:  # not what a test put there
        raw = io.FileIO(sys.stderr.fileno(), "w", closefd=False)
        sys.stderr = Forgiving(raw, sys.stderr.encoding, "backslashreplace", line_buffering=True, write_through=True)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(OneLine("cloak: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    logging.captureWarnings(True)
    warnings.formatwarning = _warning_words


class OneLine(logging.Formatter):
    """Writes line breaks in messages out: a path may hold some."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return one_line(super().formatMessage(record))


@contextlib.contextmanager
def saying() -> Iterator[None]:
    """Guard a block that writes on standard output; a reader who leaves (`| head`) is no error.

    Anything else that the system has against it (a full disk) is an InputError.
    """
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except OSError as error:
        # What is still held back must not be tried again when the process ends.
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            raise InputError(f"standard output: cannot be written ({error.strerror or error})") from None


@contextlib.contextmanager
def kept_for_json() -> Iterator[None]:
    """Send all that a block writes on standard output to standard error, compiled libraries and children included.

    InputError: standard output is closed, so that nobody could read the JSON.
    """
    if "stdout" in ABSENT:
        raise InputError("standard output: closed, and --json writes there")
    with contextlib.redirect_stdout(sys.stderr), _descriptor_as(1, 2):
        yield


@contextlib.contextmanager
def _descriptor_as(one: int, other: int) -> Iterator[None]:
    sys.__stdout__.flush()
    kept = os.dup(one)
    os.dup2(other, one)
    try:
        yield
    finally:
        os.dup2(kept, one)
        os.close(kept)


def _open_what_is_closed() -> None:
    """Point closed descriptors nowhere: the next file to be opened must not become standard output."""
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
            ABSENT.add(name)
        if getattr(sys, name) is None:
            raw = io.FileIO(number, mode, closefd=False)
            buffered = io.BufferedWriter(raw) if mode == "w" else io.BufferedReader(raw)
            stream = io.TextIOWrapper(buffered, "utf-8", "backslashreplace")
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)


def _warning_words(message: Warning | str, category: type[Warning], *_: object) -> str:
    return f"{message}" if category is UserWarning else f"{category.__name__}: {message}"
