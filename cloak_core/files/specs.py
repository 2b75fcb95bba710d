"""Specs: lines of text that name something, their parts parted by colons, such as `darknet:CFG:WEIGHTS`.

`SPEC[SELECTION]` takes some bodies of a scene, some images of a folder: `bodies.npz[0:4]` are the first four bodies,
`photos[1::2]` every second photograph, `sample[walking*,running*]` the bodies of these names; several choices are
joined by commas and keep their order.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from .errors import InputError

_SLICE = re.compile(r"(-?\d*):(-?\d*)(?::(-?\d*))?")
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


def split_selection(spec: str) -> tuple[str, str | None]:
    """Split a spec from its selection: ("bodies.npz", "0:4") from "bodies.npz[0:4]"; None where all is meant.

    A file that really is called so is taken by its name.
    """
    whole, bracket, selection = spec.removesuffix("]").rpartition("[")
    if not (bracket and whole and spec.endswith("]")):
        return spec, None
    with contextlib.suppress(OSError):  # a long selection is longer than any file's name
        if Path(spec).exists():
            return spec, None
    return whole, selection


def select(selection: str, names: Sequence[str], spec: str) -> list[int]:
    """Find the indices that a selection picks among things called `names`.

    Each of its comma-separated choices is a number (negative ones count from the end), a slice A:B or A:B:STEP, or a
    name in which * and ? stand for anything. Raises `InputError` naming `spec` for what picks nothing or repeats.
    """
    picked: list[int] = []
    for choice in selection.split(","):
        chosen = _choose(choice.strip(), names, spec)
        if not chosen:
            raise InputError(f"{spec}: '{choice.strip()}' picks none of {_listed(names)}")
        picked += chosen
    repeated = [index for index, count in Counter(picked).items() if count > 1]
    if repeated:
        raise InputError(f"{spec}: picks '{names[repeated[0]]}' twice")
    return picked


def _choose(choice: str, names: Sequence[str], spec: str) -> list[int]:
    count = len(names)
    if re.fullmatch(r"-?\d+", choice):
        index = int(choice)
        if not -count <= index < count:
            raise InputError(f"{spec}: there is no number {index} among {_listed(names)}")
        return [index % count]
    bounds = _SLICE.fullmatch(choice)
    if bounds:
        start, stop, step = (int(part) if part else None for part in bounds.groups())
        if step == 0:
            raise InputError(f"{spec}: a step of 0 leads nowhere")
        return list(range(count))[start:stop:step]
    return [i for i, name in enumerate(names) if fnmatchcase(name, choice)]


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    return f"{len(names)} ({shown})"
