"""How CPU threads share geometry: each works on views, or bands of one, of its own."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

MOST_WORKERS = 4
"""Beyond, threads wait for each other's Python between operations of some ten microseconds."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextlib.contextmanager
def torch_threads(count: int | None = None) -> Iterator[None]:
    """Set torch's number of threads within, where one is given, and set this thread's again at the end.

    One thread is what views are built on: of their hundreds of small operations a second one speeds up none, but where
    anything else runs on the machine each waits for both threads to be scheduled, which made views 50 times slower.
    The setting belongs to the calling thread: what others do meanwhile keeps theirs.

    torch starts a thread with the number that any thread set last: so later ones begin with this thread's, whatever
    threads that end inside set for themselves.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def workers(device: torch.device) -> int:
    """Choose how many threads work on views at once: as many as torch may use here, up to `MOST_WORKERS`."""
    return min(torch.get_num_threads(), MOST_WORKERS) if device.type == "cpu" else 1


def spread(work: Callable[[Item], Result], items: Sequence[Item], count: int) -> list[Result]:
    """Work on every item, results in order, by up to `count` threads that run each operation on their own.

    They meet only at the end, so that one that has to wait for the machine does not hold up every operation of others.
    """

    results: list[Result | None] = [None] * len(items)
    left = iter(range(len(items)))

    def run() -> None:
        with torch_threads(1):
            for index in left:
                results[index] = work(items[index])

    count = min(count, len(items))
    if count <= 1:
        run()
        return results
    with torch_threads(), ThreadPoolExecutor(count - 1) as pool:
        others = [pool.submit(run) for _ in range(count - 1)]
        run()
        for other in others:
            other.result()
    return results
