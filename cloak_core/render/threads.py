"""How many CPU threads geometry gets: one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Run what is inside on one CPU thread.

    A view takes hundreds of small operations, and a second thread gains next to nothing in them; but where anything
    else runs on the machine, each of them waits for both threads to be scheduled, which made views 50 times slower.
    The setting belongs to the calling thread: what other threads do meanwhile keeps theirs.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
