"""The one cache in memory: what it holds is what it counts, whoever asks at the same time."""

import threading

import numpy as np
import pytest
import torch

from cloak_core.files.caching import MemoryCache


def test_the_least_recently_used_go_first() -> None:
    cache = MemoryCache(250)
    for key in "abc":
        cache.put(key, np.zeros(100, np.uint8))
        cache.get("a")
    assert cache.bytes == 200 and cache.get("b") is None
    assert cache.get("a") is not None and cache.get("c") is not None
    cache.put("d", np.zeros(1000, np.uint8))
    assert cache.bytes == 1000 and cache.get("d") is not None, "the newest stays, whatever its size"
    cache.put("d", np.zeros(10, np.uint8))
    assert cache.bytes == 10


def test_shared_memory_counts_once_until_the_last_holder_is_gone() -> None:
    cache, shared = MemoryCache(5000), torch.zeros(1000)
    for key in range(5):
        cache.put(key, (shared[key:], [key]))
    assert cache.bytes == 4000
    cache.put("other", torch.zeros(500))
    assert cache.bytes == 2000, "all that shared the memory had to go before it was free"
    assert all(cache.get(key) is None for key in range(5))
    cache.put("both", {"a": shared, "b": shared[:3]})
    assert cache.bytes == 4000


@pytest.mark.slow
def test_threads_that_put_the_same_things_count_them_once() -> None:
    """Two threads once counted 14,592 bytes where 768 were held."""
    cache = MemoryCache(64 * 40)
    wrong: list[str] = []

    def work(seed: int) -> None:
        random = np.random.default_rng(seed)
        for _ in range(2000):
            key = int(random.integers(60))
            found = cache.get(key)
            if found is not None and found[0] != key:
                wrong.append(f"{key}: {found[0]}")
            if found is None:
                cache.put(key, np.full(64, key, np.uint8))

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    held = [item for key in range(60) if (item := cache.get(key)) is not None]
    assert cache.bytes == sum(item.nbytes for item in held) <= cache.limit
