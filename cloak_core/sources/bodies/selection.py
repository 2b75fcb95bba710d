"""`SPEC[SELECTION]`: some bodies of a scene, some images of a folder.

`bodies.npz[0:4]` are the first four bodies, `photos[1::2]` every second photograph, `sample[walking*,running*]` the
bodies of these names; several choices are joined by commas and keep their order.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from cloak_core.files.errors import InputError

_SLICE = re.compile(r"(-?\d*):(-?\d*)(?::(-?\d*))?")


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
        found = _choose(choice.strip(), names, spec)
        if not found:
            raise InputError(f"{spec}: '{choice.strip()}' picks none of {_listed(names)}")
        picked += found
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
