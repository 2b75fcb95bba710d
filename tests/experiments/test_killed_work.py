"""Cards, experiments and transfer matrices that were killed end as if they had not been."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.reliability_record import record

ROOT = Path(__file__).parents[2]
KILLS = max(2, int(os.environ.get("CLOAK_KILLS", "6")) // 3)


@pytest.mark.reliability
@pytest.mark.long
@pytest.mark.parametrize("kind", ["assess", "reproduce", "transfer"])
def test_killed_at_random_moments(kind: str, tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "CLOAK_CACHE": "off"}
    command = [sys.executable, "-m", "tests.experiments.killed_work", kind, str(tmp_path), str(KILLS)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["within"] > 0 and told["differences"] == [] and told["left"] == [], told
    figures = f"{told['kills']} kills, {told['within']} of them before the end; every figure as of the work not killed"
    record("Killed", f"`cloak {kind}`, begun again after each kill", figures)
