# SPDX-License-Identifier: GPL-3.0-or-later
"""What runs code or asks the network waits for this user's yes, whichever file names it.

A yes counts for what was named and the code in its file, as they are, until Blender is closed. What the user types or
chooses is named by the user.
"""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from ..files.errors import InputError
from ..files.reading import MAX_TEXT_BYTES, read_bytes
from ..files.specs import reach, split_spec, without_options
from ..session import session


class Unasked(InputError):
    """The user has not been asked about `specs` yet."""

    def __init__(self, specs: list[str]) -> None:
        super().__init__(
            f"{specs[0]} {reach(specs[0])}, and waits for your yes (without a window: --detector names it)"
        )
        self.specs = specs


def allow(words: Iterable[str]) -> None:
    """Take these words of a command line for named by the user."""
    session.allowed |= set(map(_content, _acting(words)))


def require(words: Iterable[str]) -> None:
    """Raise `Unasked` for words of a command line that run code or ask the network and have no yes."""
    if unasked := [spec for spec in _acting(words) if _content(spec) not in session.allowed]:
        raise Unasked(unasked)


def _acting(words: Iterable[str]) -> list[str]:
    values = (word.partition("=")[2] if word.startswith("--") else word for word in words)
    return [value for value in values if reach(value)]


def _content(spec: str) -> str:
    bare = without_options(spec)
    files = (Path(part) for part in split_spec(bare))
    code = [read_bytes(file, MAX_TEXT_BYTES) for file in files if file.is_file()] if reach(bare) == "runs code" else []
    return hashlib.sha256(b"\0".join([bare.encode(), *code])).hexdigest()
