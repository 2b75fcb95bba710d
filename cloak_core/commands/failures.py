"""Which failures are no defect of ours: bad input, a user's code, memory or a disk that is full. One line for each."""

from __future__ import annotations

import errno
import sys

from cloak_core.files.errors import InputError, first_line, one_line

_FULL_MEMORY = (
    "can't allocate memory",
    "Cannot allocate memory",
    "out of memory",
    "bad_alloc",
    "bad allocation",
    "failed to map segment from shared object",  # the loader, of a module whose file is there
)


def in_words(error: BaseException) -> str | None:
    """Say what to tell the user of an error; None for a defect, whose traceback is to be seen."""
    if isinstance(error, InputError):
        return str(error)
    if memory_is_full(error):
        return f"not enough memory ({one_line(first_line(error))[:160]})"
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return one_line(f"{error.filename or 'a file'}: cannot be written ({error.strerror})")
    foreign = sys.modules.get("cloak_core.detectors.foreign_code")
    words = foreign and foreign.culprit(error)
    return one_line(words) if words else None


def memory_is_full(error: BaseException | None) -> bool:
    """Tell whether an error, or one behind it, says that no memory is left: Python's, torch's, the system's."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError":
            return True
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:
            return True
        if isinstance(error, (RuntimeError, ImportError)) and any(word in str(error) for word in _FULL_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False
