"""A run's event log: one JSON object per line, readable while it grows and after any crash.

Every event has "type", "step" (updates done) and "time" (seconds of training so far, resumed runs included; it never
runs backwards, whatever the clock does).
"""

import contextlib
import json
import os
from collections.abc import Callable
from pathlib import Path

from cloak_core.files.errors import InputError
from cloak_core.files.reading import open_regular, parse_json
from cloak_core.files.writing import open_to_append, write_bytes, written

MAX_LINE = 1 << 20
"""Bytes; no event is longer."""
MAX_BYTES = 256 << 20
"""Of a log: more than a million steps."""
Event = dict[str, object]
OnEvent = Callable[[Event], None]


class EventLog:
    """Appends events to a file and tells them to a listener."""

    def __init__(self, path: Path, on_event: OnEvent | None = None) -> None:
        self._listener = on_event
        self._file = open_to_append(path)
        self.path = path

    def write(self, event: Event) -> None:
        """Append one event: in one write, so that a kill cannot leave two halves."""
        with written(self.path):
            self._file.write(json.dumps(event, allow_nan=False).encode() + b"\n")
        if self._listener:
            self._listener(event)

    def close(self) -> None:
        self._file.close()


def read_events(path: str | os.PathLike) -> list[Event]:
    """Read the events of a run; torn lines and lines that are no JSON objects are skipped."""
    events = []
    with open_regular(path, MAX_BYTES) as file:
        while line := file.readline(MAX_LINE):
            with contextlib.suppress(InputError):
                events.append(parse_json(line, "an event"))
    return events


def rewind_events(path: Path, step: int) -> None:
    """Drop what was logged after `step`, and how the run ended: it goes on from there."""
    events = read_events(path) if path.exists() else []
    kept = [e for e in events if isinstance(e.get("step"), int) and e["step"] <= step and e.get("type") != "end"]
    write_bytes(path, b"".join(json.dumps(e).encode() + b"\n" for e in kept))
