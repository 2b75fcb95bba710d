"""Folders that appear whole or not at all, and locks: what killed processes leave goes, what living ones hold stays."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cloak_core.files.writing import DAY, is_held, lock, new_folder, open_to_append, write_bytes

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


HOLD = (
    "import sys; from pathlib import Path; from cloak_core.files.writing import lock\n"
    "with lock(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
)


def test_a_lock_is_held_until_its_process_is_gone_however_that_ends(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    assert not is_held(path) and not path.exists()  # asking makes nothing
    holder = subprocess.Popen([sys.executable, "-c", HOLD, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert holder.stdout is not None and holder.stdout.readline() == b"held\n"
    assert is_held(path)
    with pytest.raises(BlockingIOError), lock(path):
        pass
    holder.kill()
    holder.communicate(timeout=120)
    assert not is_held(path)
    with lock(path):  # asking took nothing
        pass


def test_what_is_no_lock_file_is_held_by_nobody(tmp_path: Path) -> None:
    (tmp_path / ".lock").mkdir()
    assert not is_held(tmp_path / ".lock")
