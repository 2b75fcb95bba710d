"""The error for bad input, and the end of work that was stopped in order."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Bad input from the user: one clear line that names the file or option. The command line exits with 2.

    Line breaks and control characters in the message (a path may hold some) are written out: it stays one line.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class Stopped(Exception):
    """Work ended early but in order (cancelled, out of budget); the same call goes on. The command line exits with 3.

    The message says where it stopped.
    """


def one_line(text: str) -> str:
    r"""The text with line breaks and control characters written out (\n, \x1b)."""
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def first_line(error: BaseException) -> str:
    """What an exception says, on one line; its class's name where it says nothing, or fails to."""
    try:
        words = str(error).strip()
    except Exception:  # an exception of somebody else's making
        words = ""
    return words.splitlines()[0] if words else type(error).__name__


def suggestion(name: str, known: Iterable[str], least: float = 0.7) -> str:
    """Write "; did you mean X?" for the nearest of the known names; "" where none is at `least` this similar."""
    near = difflib.get_close_matches(name, list(known), 1, least)
    return f"; did you mean {near[0]}?" if near else ""
