"""Files that save work between runs: decoded images, and the cache of files that they lie in."""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.files.caching import DiskCache, cache_folder
from cloak_core.sources.backdrops import backgrounds as module
from cloak_core.sources.backdrops.backgrounds import load_backgrounds

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


def test_where_the_folder_is(monkeypatch, tmp_path):
    monkeypatch.setenv("CLOAK_CACHE", "off")
    assert cache_folder("images") is None
    monkeypatch.setenv("CLOAK_CACHE", str(tmp_path))
    assert cache_folder("images") == tmp_path / "images"
    monkeypatch.delenv("CLOAK_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder("images") == tmp_path / "cloak" / "images"


def test_the_second_run_decodes_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("CLOAK_CACHE", str(tmp_path / "cache"))
    random = np.random.default_rng(0)
    for i in range(3):
        Image.fromarray(random.integers(0, 255, (40, 60, 3)).astype(np.uint8)).save(tmp_path / f"{i}.png")
    first = load_backgrounds(tmp_path, (32, 32))
    batch = first.batch([0, 1, 2], 32, 32)
    monkeypatch.setattr(module, "_decode", None)
    monkeypatch.setattr(module, "MEMORY_BYTES", 1)
    second = load_backgrounds(tmp_path, (32, 32))
    assert (second.batch([0, 1, 2], 32, 32) == batch).all() and second.identities() == first.identities()
    for i in range(3):
        (tmp_path / f"{i}.png").unlink()
    assert (second.batch([2, 1, 0], 32, 32) == batch.flip(0)).all()
