"""Locks between processes, and asking whether somebody holds one."""

import subprocess
import sys
from pathlib import Path

import pytest

from cloak_core.files.writing import is_held, lock

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
