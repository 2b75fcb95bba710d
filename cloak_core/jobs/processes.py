"""Jobs in processes of this machine, one for each core.

A process is `python -m cloak_core.jobs.processes`: it imports nothing of the program that asks, which therefore may be
any script. It has one thread and reads pickles of (work, arguments) from a pipe until that ends; for each it writes
(result, error, seconds, defect) to another.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence

from cloak_core.jobs.job import Job, Outcome, done

RETRIES = 3
"""Of a job whose process died."""
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
END_SECONDS = 5


class Processes:
    """An `Executor`: jobs that take one core each."""

    def __init__(self, count: int | None = None) -> None:
        """count: of processes; None: one for each core that this process may use."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._count = count or cores

    def run(self, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """See `Executor`. RuntimeError: a job's process died again and again."""
        left: queue.SimpleQueue[Job] = queue.SimpleQueue()
        for job in jobs:
            left.put(job)
        answers: queue.SimpleQueue[Outcome | BaseException] = queue.SimpleQueue()
        workers = [_Worker(left, answers) for _ in range(min(self._count, len(jobs)))]
        try:
            for worker in workers:
                worker.start()
            for _ in jobs:
                answer = answers.get()
                if isinstance(answer, BaseException):
                    raise answer
                yield answer
        finally:
            for worker in workers:
                worker.end()


class _Worker(threading.Thread):
    """A thread that hands jobs to a process of its own."""

    def __init__(self, left: queue.SimpleQueue, answers: queue.SimpleQueue) -> None:
        super().__init__(daemon=True)
        self._left, self._answers, self._ended = left, answers, False
        self._process: subprocess.Popen | None = None

    def run(self) -> None:
        try:
            while not self._ended:
                self._answers.put(self._done(self._left.get_nowait()))
        except queue.Empty:
            pass
        except BaseException as error:
            self._answers.put(error)

    def _done(self, job: Job) -> Outcome:
        for _ in range(RETRIES):
            try:
                if self._process is None:
                    self._process = _started()
                pickle.dump((job.work, dict(job.arguments)), self._process.stdin)
                self._process.stdin.flush()
                result, error, seconds, defect = pickle.load(self._process.stdout)
            except (EOFError, OSError, pickle.UnpicklingError):  # the process died
                if self._ended:
                    break
                self._process.kill()
                self._process = None
                continue
            if defect is not None:
                raise defect
            return Outcome(job, result, error, seconds)
        raise RuntimeError(f"{job.name}: its process died {RETRIES} times (out of memory?)")

    def end(self) -> None:
        """End the process; what it was doing is dropped."""
        self._ended = True
        if self._process is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
            self._process.terminate()
            try:
                self._process.wait(END_SECONDS)
            except subprocess.TimeoutExpired:
                self._process.kill()


def _started() -> subprocess.Popen:
    own = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))} | dict.fromkeys(THREADS, "1")
    command = [sys.executable, "-m", "cloak_core.jobs.processes"]
    # A session of its own: Ctrl-C reaches whoever asks, and that ends the process.
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | own, start_new_session=True
    )


def serve() -> None:
    """Do jobs until standard input ends. Only the process that started this one writes there."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a job prints is no answer
    while True:
        try:
            work, arguments = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        defect = None
        try:
            outcome = done(Job("", work, arguments))
            answer = (outcome.result, outcome.error, outcome.seconds)
        except Exception as error:
            answer = (None, "", 0.0)
            defect = _pickled(error)
        pickle.dump((*answer, defect), answers)
        answers.flush()


def _pickled(error: Exception) -> Exception:
    """The error itself, where another process can read it, or its words."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


if __name__ == "__main__":
    serve()
