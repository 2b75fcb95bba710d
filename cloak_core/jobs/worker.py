"""A process that does jobs for the one that started it: `python -m cloak_core.jobs.worker`.

Reads pickles of (work, arguments) from standard input until that ends, and writes (result, error, seconds, defect) for
each. Only the process that started this one writes there.
"""

from __future__ import annotations

import os
import pickle
import sys

from cloak_core.jobs.job import Job, done


def serve() -> None:
    """Do jobs until standard input ends."""
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
