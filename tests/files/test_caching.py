"""Caches, in memory and on disk: what they hold is what they count, and what is damaged is not there."""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch

from cloak_core.files.caching import DiskCache, MemoryCache
from cloak_core.zoo import entry as zoo


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


DATA = bytes(range(100))


def cache(folder: Path, limit: int = 1 << 30) -> DiskCache:
    return DiskCache(folder, ".rgb", limit, "decoded images")


def test_what_is_put_is_there_again_and_can_be_written_to_in_memory_alone(tmp_path):
    cache(tmp_path).put("a", DATA)
    found = cache(tmp_path).get("a")
    assert found.tobytes() == DATA
    found[:] = 0
    assert cache(tmp_path).get("a").tobytes() == DATA and cache(tmp_path).get("b") is None


@pytest.mark.parametrize("damage", ["torn", "changed", "empty", "folder"])
def test_damaged_files_count_as_absent(tmp_path, damage: str):
    cache(tmp_path).put("a", DATA)
    (file,) = tmp_path.iterdir()
    data = file.read_bytes()
    if damage == "folder":
        file.unlink()
        file.mkdir()
    else:
        file.write_bytes({"torn": data[:-9], "changed": bytes([data[0] ^ 1]) + data[1:], "empty": b""}[damage])
    assert cache(tmp_path).get("a") is None


def test_the_least_recently_used_go_when_there_are_too_many_and_nothing_else(tmp_path):
    (tmp_path / "holiday.jpg").write_bytes(bytes(10_000))
    for i in range(8):
        cache(tmp_path).put(f"{i}", DATA)
        os.utime(tmp_path / f"{i}.rgb", (1000 + i, 1000 + i))
    assert cache(tmp_path).get("2") is not None
    # The first file of a run already counts those of earlier ones.
    cache(tmp_path, limit=3 * (len(DATA) + 4)).put("8", DATA)
    assert [i for i in range(9) if cache(tmp_path).get(f"{i}") is not None] == [2, 7, 8]
    assert (tmp_path / "holiday.jpg").exists()


def test_many_writers_of_one_file_leave_one_sound_file(tmp_path):
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: cache(tmp_path).put("a", DATA), range(40)))
    assert len(list(tmp_path.iterdir())) == 1 and cache(tmp_path).get("a").tobytes() == DATA


def test_where_nothing_can_be_written_nothing_is_kept(tmp_path, caplog):
    (tmp_path / "file").write_text("in the way")
    files = cache(tmp_path / "file" / "images")
    assert not files.put("a", DATA) and not files.put("b", DATA)
    assert files.get("a") is None and caplog.text.count("not kept") == 1


@pytest.mark.parametrize("content", [b"", b"\0\0\0\0", b"\0" * 64, b"\0"])
def test_a_cache_file_of_zeros_is_no_data(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.view").write_bytes(content)
    assert DiskCache(tmp_path, ".view", 1 << 20, "views").get("a") is None


ASK = """
import sys
from cloak_core.zoo.entry import run_path
print(run_path("zoo:builtin-sample"))
"""


def test_many_processes_may_meet_at_a_cold_cache(tmp_path: Path) -> None:
    environment = os.environ | {"CLOAK_CACHE": str(tmp_path)}
    ask = [sys.executable, "-c", ASK]
    asked = [subprocess.Popen(ask, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE) for _ in range(4)]
    answers = [process.communicate() for process in asked]
    assert [process.returncode for process in asked] == [0] * 4, answers
    assert len({place for place, _ in answers}) == 1 and not any(said for _, said in answers)


def test_a_cache_that_cannot_be_written_is_done_without(tmp_path: Path, monkeypatch, caplog) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CLOAK_CACHE", str(tmp_path / "file"))
    zoo._run_of.cache_clear()
    run = zoo.run_path("zoo:builtin-sample")
    assert np.load(run / "colors.npy").shape[1] == 3
    assert "are not kept" in caplog.text
    zoo._run_of.cache_clear()
