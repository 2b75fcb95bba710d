"""Ends what a killed process leaves of the Ray cluster that it started on this machine.

`python -m cloak_core.jobs.ray_keeper SESSION` waits until its standard input ends, which the system sees to however
its parent dies, gives Ray time to end by itself, and then ends the processes that were started for this session: Ray's
own agents outlive a killed driver. Linux alone: elsewhere nothing is looked for.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_bytes

GRACE_SECONDS = 5.0
CLOSE_SECONDS = 30.0
"""What the keeper may take to end after the cluster was shut down in order."""


@contextlib.contextmanager
def kept(session: str) -> Iterator[None]:
    """Run a block whose process owns the Ray session of this name, which ends with the process, however it ends."""
    command = [sys.executable, "-m", "cloak_core.jobs.ray_keeper", session]
    keeper = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        keeper.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            keeper.wait(CLOSE_SECONDS)


def processes_of(session: str) -> list[int]:
    """Find the processes of a Ray session, but for this one.

    Their command lines name it, or they are Ray's by their title and have its logs open.
    """
    processes = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, InputError):  # ended meanwhile, or somebody else's
            words = read_bytes(folder / "cmdline").split(b"\0")
            named = any(session.encode() in word for word in words)
            titled = words[0].startswith(b"ray::") and any(session in os.readlink(f) for f in (folder / "fd").iterdir())
            if (named or titled) and b"cloak_core.jobs.ray_keeper" not in words:
                processes.append(int(folder.name))
    return processes


def wait_and_end(session: str) -> None:
    """Wait for the end of standard input, then for Ray's own end, then end what is left."""
    sys.stdin.buffer.read()
    until = time.monotonic() + GRACE_SECONDS
    while processes_of(session) and time.monotonic() < until:
        time.sleep(0.2)
    for process in processes_of(session):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(process, signal.SIGKILL)


if __name__ == "__main__":
    # The end of a session of jobs is not the end of its keeper.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    wait_and_end(sys.argv[1])
