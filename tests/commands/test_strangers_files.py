"""Hundreds of files from strangers, through the command line: no traceback, no code run, nothing written elsewhere, no
more than 2 GiB taken (the process is not given more), and one line that names what is wrong."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands import malformed
from tests.reliability_record import record

ROOT = Path(__file__).parents[2]
DAMAGED = int(os.environ.get("CLOAK_DAMAGED", "3"))
"""Seeds of damage for each kind of file."""


@pytest.mark.reliability
@pytest.mark.long
def test_files_from_strangers(tmp_path):
    (tmp_path / "sound").mkdir()
    malformed.sound(tmp_path / "sound")
    count = len(malformed.cases(DAMAGED))
    command = [sys.executable, "-m", "tests.commands.malformed", str(tmp_path), "0", str(count), str(DAMAGED)]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "CLOAK_CACHE": "off"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stderr[-3000:]
    records = json.loads(done.stdout)
    wrong = [f"{r['name']}: {r['wrong']}" for r in records if r["wrong"]]
    assert not wrong, "\n".join(wrong)
    assert len(records) == count >= 200
    refused = [r for r in records if r["code"] == 2]
    assert all(r["said"].splitlines()[-1].startswith("cloak: ") for r in refused)
    section = "Files from strangers"
    record(section, "malformed inputs, by hand and by seeded damage", count)
    record(section, "refused in one line / read or recovered from", f"{len(refused)} / {count - len(refused)}")
    record(section, "tracebacks, executed code, files outside the run folder, more than 2 GiB of memory", 0)
