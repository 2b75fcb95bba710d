"""Training in several processes, as torchrun starts them."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cloak_core.attack.checkpoints import load_checkpoint
from cloak_core.attack.events import read_events
from cloak_core.scene.exchange import read_colors
from tests.attack.test_training import run
from tests.reliability_record import record

ROOT = Path(__file__).parents[2]
RANK = """
import os, sys
from pathlib import Path
from cloak_core.errors import InputError
from tests.attack.test_training import run
die_at = int(sys.argv[3])
def say(event):
    if event["type"] == "step":
        print(event["step"], flush=True)
from cloak_core.attack import trainer
if os.environ["RANK"] == "1" and die_at and os.environ["TORCHELASTIC_RESTART_COUNT"] == "0":
    # This rank vanishes in the middle of a step; not again after a restart.
    before = trainer.gradient_step
    calls = []
    def dying(*args, **kwargs):
        calls.append(1)
        if len(calls) == die_at:
            os._exit(9)
        return before(*args, **kwargs)
    trainer.gradient_step = dying
try:
    run(Path(sys.argv[1]), steps=int(sys.argv[2]), batch=5, resume=True, threads=1, checkpoint_every=100, on_event=say)
except InputError as error:
    print(error, file=sys.stderr, flush=True)
    sys.exit(2)
"""


def torchrun(tmp_path: Path, out: Path, steps: int, die_at: int = 0, restarts: int = 0) -> subprocess.CompletedProcess:
    script = tmp_path / "rank.py"
    script.write_text(RANK)
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += ["--max-restarts", str(restarts), str(script), str(out), str(steps), str(die_at)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=500)


@pytest.mark.slow
@pytest.mark.reliability
def test_two_processes_lose_one_go_on_and_reach_what_one_does(tmp_path):
    """Within 1e-5 after 20 steps of an odd batch (sums are rounded in another order)."""
    done = torchrun(tmp_path, tmp_path / "two", 20, die_at=8)
    assert done.returncode != 0
    assert "lost another process of this run after step 7" in done.stderr
    checkpoint, damaged = load_checkpoint(tmp_path / "two" / "checkpoint")
    assert checkpoint.step == 7 and damaged == []
    done = torchrun(tmp_path, tmp_path / "two", 20, die_at=8, restarts=1)
    assert done.returncode == 0, done.stderr
    events = read_events(tmp_path / "two" / "events.jsonl")
    assert [e["step"] for e in events if e["type"] == "resume"] == [7, 14]
    one = run(tmp_path / "one", steps=20, batch=5, threads=1)
    difference = np.abs(read_colors(tmp_path / "two" / "colors.npy") - one.colors).max()
    assert difference < 1e-5
    section = "Several processes"
    record(
        section, "a process dies in step 8 of 20", "`lost another process of this run after step 7`; checkpoint valid"
    )
    record(section, "a process dies again, under torchrun --max-restarts 1", "the restart goes on from the checkpoint")
    record(section, "colours of two processes, after both, against one process, 20 steps", f"{difference:.1e} apart")
