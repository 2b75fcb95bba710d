"""Specs: lines of text that name something, their parts parted by colons, such as `darknet:CFG:WEIGHTS`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from .errors import InputError

_PART = re.compile(r"(?:^|:)((?:[A-Za-z]:(?=[\\/]))?[^:]*)")


def split_spec(spec: str) -> list[str]:
    r"""The parts between the colons, empty ones too.

    The colon of a Windows drive (`C:\a.cfg`, `C:/a.cfg`) parts nothing, on any system: a spec means the same
    everywhere. So a file whose name is one letter, before a path from the root, is written `./a:/b`.
    """
    return _PART.findall(spec)


def reach(spec: str) -> str:
    """Say what loading a spec does beyond reading files: "runs code", "asks the network", or "" for neither.

    This alone decides it, for what any file says: a run, a command, a .blend, a card, a sweep, an entry of the zoo.
    """
    parts = spec.split(":")
    if "python" in parts or parts[0] == "pattern":
        return "runs code"
    # A folder of the network's own (UNC) hands Windows' password to whoever keeps it.
    if any(part.startswith(("//", "\\\\")) for part in parts[1:]):
        return "asks the network"
    named = without_options(spec.partition("transformers:")[2])
    return "asks the network" if "transformers" in parts and not Path(named).expanduser().is_dir() else ""


def require_named(specs: Iterable[str], whose: str | Path, named: Iterable[str] = ()) -> None:
    """Refuse specs of a file that run code or ask the network, unless the caller named them, too (InputError).

    whose: the file, for the message.
    """
    known = set(named)
    for spec in specs:
        if spec not in known and (does := reach(spec)):
            raise InputError(f"{whose}: names {spec}, which {does}: only where you name it, too: --detector {spec}")


def without_options(spec: str) -> str:
    """Drop the options after the last @, which hold no colon and no separator of folders."""
    return re.sub(r"@[^@:/\\]*$", "", spec)


def without_folders(text: str) -> str:
    """Commands and specs with the names of files alone: where they lie is nobody's business.

    onnx:/a/b/c.onnx@320 -> onnx:c.onnx@320
    """
    return re.sub(r"/?([^\s/:=@,'\"]+/)+", "", text)
