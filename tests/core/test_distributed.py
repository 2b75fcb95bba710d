"""Training in several processes, as torchrun starts them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file

from cloak_core.core.checkpoints import load_checkpoint
from cloak_core.core.ensemble import Ensemble
from cloak_core.core.events import read_events
from cloak_core.exchange.face_lists import read_colors
from tests.core.fakes import TinyDetector
from tests.core.test_training import run
from tests.reliability_record import record

ROOT = Path(__file__).parents[2]
RANK = """
import json, os, sys
from pathlib import Path
from safetensors.torch import save_file
from cloak_core.files.errors import InputError
from cloak_core.core import train, training
from tests.core.fakes import TinyDetector
from tests.core.test_training import run
plan = json.loads(sys.argv[1])
out = Path(plan["out"])
def say(event):
    if event["type"] == "step":
        print(event["step"], flush=True)
        if event["step"] == plan["cancel_at"]:
            (out / "cancel").touch()
if os.environ["RANK"] == "1" and plan["die_at"] and os.environ["TORCHELASTIC_RESTART_COUNT"] == "0":
    # This rank vanishes in the middle of a step; not again after a restart.
    before = training.gradient_step
    calls = []
    def dying(*args, **kwargs):
        calls.append(1)
        if len(calls) == plan["die_at"]:
            os._exit(9)
        return before(*args, **kwargs)
    training.gradient_step = dying
class Telling(training.TrainingLoop):
    def run_to_end(self, stop):
        result = super().run_to_end(stop)
        if self.objective.ensemble.is_adaptive:
            save_file(self.objective.ensemble.state(), f"{out}.rank{self.world.rank}")
        return result
train.TrainingLoop = Telling
try:
    detectors = [TinyDetector(0), TinyDetector(1, bias=2.0)]
    run(out, detectors, batch=5, resume=True, threads=1, checkpoint_every=100, on_event=say, **plan["settings"])
except InputError as error:
    print(error, file=sys.stderr, flush=True)
    sys.exit(2)
"""


SMOOTH = {"initial": "random"}
"""Of settings: total variation has a kink where neighbours have one colour, and from grey Adam's first step, which has
one length for all, makes many such. There a sum's order decides the sign of a gradient that Adam then takes in full."""


def torchrun(
    out: Path, settings: dict, die_at: int = 0, restarts: int = 0, cancel_at: int = 0
) -> subprocess.CompletedProcess:
    """Two ranks of five images. One may die, or ask both to stop."""
    script = out.with_name("rank.py")
    script.write_text(RANK)
    plan = {"out": str(out), "settings": settings, "die_at": die_at, "cancel_at": cancel_at}
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += ["--max-restarts", str(restarts), str(script), json.dumps(plan)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=500)


@pytest.mark.long
@pytest.mark.reliability
def test_two_processes_lose_one_go_on_and_reach_what_one_does(tmp_path):
    """Within 1e-5 after 20 steps of an odd batch (sums are rounded in another order)."""
    scheme = {"steps": 20} | SMOOTH
    done = torchrun(tmp_path / "two", scheme, die_at=8)
    assert done.returncode != 0
    assert "lost another process of this run after step 7" in done.stderr
    checkpoint, damaged = load_checkpoint(tmp_path / "two" / "checkpoint")
    assert checkpoint.step == 7 and damaged == []
    done = torchrun(tmp_path / "two", scheme, die_at=8, restarts=1)
    assert done.returncode == 0, done.stderr
    events = read_events(tmp_path / "two" / "events.jsonl")
    assert [e["step"] for e in events if e["type"] == "resume"] == [7, 14]
    detectors = [TinyDetector(0), TinyDetector(1, bias=2.0)]
    one = run(tmp_path / "one", detectors, batch=5, threads=1, **scheme)
    difference = np.abs(read_colors(tmp_path / "two" / "colors.npy") - one.colors).max()
    assert difference < 1e-5
    section = "Several processes"
    lost = "`lost another process of this run after step 7`; checkpoint valid"
    record(section, "a process dies in step 8 of 20", lost)
    record(section, "a process dies again, under torchrun --max-restarts 1", "the restart goes on from the checkpoint")
    record(section, "colours of two processes, after both, against one process, 20 steps", f"{difference:.1e} apart")


@pytest.mark.long
def test_processes_agree_about_an_adaptive_ensemble_and_resume_to_the_same_bits(tmp_path, monkeypatch):
    """The odd batch leaves one process an image more than the other."""
    scheme = {"steps": 14, "angles": "0..360", "ensemble": "adaptive"} | SMOOTH
    done = torchrun(tmp_path / "two", scheme)
    assert done.returncode == 0, done.stderr
    seen = [load_file(tmp_path / f"two.rank{rank}") for rank in (0, 1)]
    assert all((seen[0][name] == seen[1][name]).all() for name in seen[0])
    torchrun(tmp_path / "stopped", scheme, cancel_at=7)
    assert load_checkpoint(tmp_path / "stopped" / "checkpoint")[0].step < 14
    done = torchrun(tmp_path / "stopped", scheme)
    assert done.returncode == 0, done.stderr
    two, resumed = (read_colors(tmp_path / name / "colors.npy") for name in ("two", "stopped"))
    assert np.array_equal(two, resumed)
    detectors = [TinyDetector(0), TinyDetector(1, bias=2.0)]
    one = run(tmp_path / "one", detectors, batch=5, threads=1, **scheme)
    assert np.abs(two - one.colors).max() < 1e-5
    # What was found decides who counts: without it the same run goes elsewhere.
    monkeypatch.setattr(Ensemble, "observe", lambda *args: None)
    assert np.abs(run(tmp_path / "blind", detectors, batch=5, threads=1, **scheme).colors - one.colors).max() > 1e-3
