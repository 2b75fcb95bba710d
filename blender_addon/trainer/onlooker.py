# SPDX-License-Identifier: GPL-3.0-or-later
"""`cloak look` as a process that stays: asked on its standard input, it answers in files. Blender never waits for it.

It stands beside the one job of this Blender, so that a training can be watched. When Blender ends, however that
happens, its standard input ends and so does the process.
"""

import contextlib
import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from ..files.errors import InputError
from ..files.reading import read_json
from .jobs import last_words
from .program import start_process

ANSWER = "look.json"


@dataclass(frozen=True)
class Glance:
    """What one detector saw of one kind of clothing."""

    score: float  # of the surest person, thresholded or not
    boxes: tuple[tuple[float, ...], ...]
    """x1, y1, x2, y2, score; pixels of the picture from its upper left; best first."""
    operating_point: float

    @property
    def found(self) -> bool:
        return self.score > self.operating_point

    def describe(self) -> str:
        """found, 0.97."""
        return f"{'found' if self.found else 'hidden'}, {self.score:.2f}"


@dataclass(frozen=True)
class Seen:
    """An answer: by detector and by "clothing" and "cloak"; and the pictures that were looked at."""

    glances: dict[str, dict[str, Glance]]
    pictures: dict[str, Path]
    width: int
    height: int


class Onlooker:
    """The process. `ask` and look in with `answer`; one question at a time."""

    def __init__(self, command: list[str], folder: Path) -> None:
        self.folder = folder
        self.waiting = False
        self._log = folder / "look.log"
        self._log.unlink(missing_ok=True)
        self._process = start_process(command, subprocess.DEVNULL, self._log, stdin=subprocess.PIPE)

    def failure(self) -> str:
        """Why it has ended; "" while it lives."""
        code = self._process.poll()
        return "" if code is None else last_words(self._log) or f"The detector's process ended (exit code {code})"

    def ask(self, request: dict) -> None:
        """Ask; the answer comes in a while."""
        with contextlib.suppress(FileNotFoundError):
            (self.folder / ANSWER).unlink()
        line = json.dumps(request | {"out": str(self.folder)}) + "\n"
        with contextlib.suppress(OSError):  # it has ended: `failure` tells
            self._process.stdin.write(line.encode())
            self._process.stdin.flush()
        self.waiting = True

    def answer(self) -> Seen | None:
        """The answer; None while it is on its way. Raises `InputError` for a question that had none."""
        path = self.folder / ANSWER
        if not self.waiting or not path.exists():
            return None
        self.waiting = False
        record = read_json(path)
        if "error" in record:
            raise InputError(str(record["error"]))
        try:
            glances = {spec: _glances(told) for spec, told in record["detectors"].items()}
            pictures = {kind: Path(path) for kind, path in record["pictures"].items()}
            return Seen(glances, pictures, int(record["width"]), int(record["height"]))
        except (KeyError, TypeError, ValueError):
            raise InputError(f"{path}: not the answer to a look") from None

    def stop(self) -> None:
        """Let it go: it ends when its standard input does; asked twice, in case it is still starting."""
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        with contextlib.suppress(OSError):
            self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(0.5)  # else nobody would take note of its end


def _glances(told: dict) -> dict[str, Glance]:
    """What one detector saw, by kind of clothing."""
    boxes = lambda one: tuple(tuple(map(float, box)) for box in one["boxes"])
    found = ((kind, told[kind]) for kind in ("clothing", "cloak") if kind in told)
    return {kind: Glance(float(one["max_person"]), boxes(one), float(told["operating_point"])) for kind, one in found}
