"""Folders that appear whole or not at all: what killed processes leave goes, what living ones write stays."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cloak_core.files.caching import DiskCache
from cloak_core.files.writing import DAY, new_folder, open_to_append, write_bytes
from cloak_core.zoo import entry as zoo

WRITER = """
import sys, time
from pathlib import Path
from cloak_core.files.writing import new_folder
with new_folder(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("x")
    print("ready", flush=True)
    time.sleep(60)
"""


def writer(target: Path) -> subprocess.Popen:
    process = subprocess.Popen([sys.executable, "-c", WRITER, str(target)], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"ready\n"
    return process


def test_what_a_killed_process_left_is_removed_and_a_living_ones_is_not(tmp_path: Path) -> None:
    living, killed = writer(tmp_path / "out"), writer(tmp_path / "out")
    other = writer(tmp_path / "other")
    try:
        os.kill(killed.pid, signal.SIGKILL)
        os.kill(other.pid, signal.SIGKILL)
        killed.wait(), other.wait()
        assert len(list(tmp_path.glob(".out.*"))) == 2
        with new_folder(tmp_path / "out") as folder:
            (folder / "whole").write_text("x")
        assert len(list(tmp_path.glob(".out.*"))) == 1, "the living one's stays"
        assert len(list(tmp_path.glob(".other.*"))) == 1, "another folder's is another's business"
        assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["whole"]
    finally:
        for process in (living, killed, other):
            process.kill()
            process.wait()


@pytest.mark.parametrize("mask", [0o077, 0o022, 0o002])
def test_what_is_written_has_the_permissions_that_the_user_asks_for(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        write_bytes(tmp_path / "file", b"")
        open_to_append(tmp_path / "log").close()
        with new_folder(tmp_path / "out") as folder:
            write_bytes(folder / "inner", b"")
    finally:
        os.umask(before)
    made = {name: (tmp_path / name).stat().st_mode & 0o777 for name in ("file", "log", "out/inner", "out")}
    assert made == {"file": 0o666 & ~mask, "log": 0o666 & ~mask, "out/inner": 0o666 & ~mask, "out": 0o777 & ~mask}


def test_what_earlier_versions_left_goes_after_a_day(tmp_path: Path) -> None:
    for name, age in ((".out.abcdefgh", 2 * DAY), (".out.ijklmnop", 60.0)):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (time.time() - age,) * 2)
    with new_folder(tmp_path / "out"):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == [".out.ijklmnop", "out"]


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
