"""Jobs on a Ray cluster (the extra `ray`): this machine's own, or one that runs already.

Ray places, retries and streams back; nothing of that is ours. All machines have Cloak installed and see the folders
that the jobs name, and the working folder, by the same names (a shared disk). A job whose machine goes away is begun
again elsewhere, from what it left in its folder.

A cluster that was started here ends with its process, however that ends: `python -m cloak_core.jobs.ray_cluster
SESSION` waits until its standard input ends, gives Ray time to end by itself, and then ends the processes of this
session (Ray's own agents outlive a killed driver). Linux alone: elsewhere nothing is looked for.
"""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_bytes
from cloak_core.jobs.job import Job, Outcome, done

LOCAL = "local"
RETRIES = 5
"""Of a job whose process or machine died."""
AHEAD = 1000
"""Jobs handed to Ray at a time: its scheduler holds each in memory."""
CONNECT_SECONDS = 10
ORDERLY_SECONDS = 120
"""What jobs may take that were asked to stop."""
GRACE_SECONDS = 5.0
CLOSE_SECONDS = 30.0
"""What the keeper may take to end after the cluster was shut down in order."""


class RayCluster:
    """`address`: of a running cluster ("auto": this machine's, "HOST:6379", "ray://HOST:10001"), or "local"."""

    def __init__(self, address: str = LOCAL) -> None:
        """Name the cluster. InputError: Ray is not installed."""
        if importlib.util.find_spec("ray") is None:
            raise InputError("--ray needs the package ray: pip install 'cloak-core[ray]'")
        self.address = address

    def run(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Do jobs as `Executor` says. InputError: no cluster there, or no machine is large enough for a job."""
        import ray

        with self._connected(ray):
            self._require_room(ray, jobs)
            left = iter(jobs)
            asked: dict[object, Job] = {}
            try:
                while True:
                    for job in itertools.islice(left, AHEAD - len(asked)):
                        asked[_submit(ray, job)] = job
                    if not asked:
                        return
                    ready, _ = ray.wait(list(asked), num_returns=1)
                    for reference in ready:
                        yield Outcome(asked.pop(reference), *ray.get(reference))
            finally:
                _stop(ray, list(asked))

    @contextlib.contextmanager
    def _connected(self, ray: ModuleType) -> Iterator[None]:
        is_ours = not ray.is_initialized()
        if is_ours:
            _require_answer(self.address)
            options = {"include_dashboard": False} if self.address == LOCAL else {}
            try:
                ray.init(self.address, log_to_driver=False, logging_level="error", **options)
            except Exception as error:
                # A bare one says that this machine was too busy to start a node within half a minute.
                if not isinstance(error, (ConnectionError, ValueError, RuntimeError)) and type(error) is not Exception:
                    raise
                raise InputError(f"--ray {self.address}: {str(error).splitlines()[0]}") from None
        is_local = is_ours and self.address == LOCAL
        with kept(ray.get_runtime_context().get_session_name()) if is_local else contextlib.nullcontext():
            try:
                yield
            finally:
                if is_ours:
                    ray.shutdown()

    def _require_room(self, ray: ModuleType, jobs: Sequence[Job]) -> None:
        machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        for cores, gpus in {(job.cores, job.gpus) for job in jobs}:
            if not any(cores <= has.get("CPU", 0) and gpus <= has.get("GPU", 0) for has in machines):
                raise InputError(
                    f"--ray {self.address}: a run asks for {cores:g} cores and {gpus:g} GPUs, and no machine has them"
                )


def _require_answer(address: str) -> None:
    """Require that somebody listens at HOST:PORT. InputError: nobody does; Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        return
    try:
        socket.create_connection((host, int(port)), timeout=CONNECT_SECONDS).close()
    except OSError as error:
        raise InputError(f"--ray {address}: nobody answers there ({error.strerror or error})") from None


def _submit(ray: ModuleType, job: Job) -> object:
    # Relative names of files mean there what they mean here.
    remote = ray.remote(_answer).options(
        num_cpus=job.cores, num_gpus=job.gpus, max_retries=RETRIES, name=job.name, scheduling_strategy="SPREAD"
    )
    return remote.remote(job, os.getcwd())


def _answer(job: Job, folder: str) -> tuple[object, str, float]:
    os.chdir(folder)
    outcome = done(job)
    return outcome.result, outcome.error, outcome.seconds


def _stop(ray: ModuleType, references: list) -> None:
    """Take back what waits, and interrupt what is being done: a training then ends in order, with its checkpoint."""
    for reference in references:
        ray.cancel(reference, force=False)
    if references:
        ray.wait(references, num_returns=len(references), timeout=ORDERLY_SECONDS)


@contextlib.contextmanager
def kept(session: str) -> Iterator[None]:
    """Run a block whose process owns the Ray session of this name, which ends with the process, however it ends."""
    command = [sys.executable, "-m", "cloak_core.jobs.ray_cluster", session]
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
            if (named or titled) and b"cloak_core.jobs.ray_cluster" not in words:
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
