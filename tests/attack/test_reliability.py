"""Runs that are killed, starved of disk or locked out: nothing is lost, and what resumes ends in the same bits.

CLOAK_KILLS sets how many kills (50 for the figures in docs/reliability.md, which CLOAK_WRITE_DOCS=1 rewrites).
"""

import json
import os
import platform
import random
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from cloak_core.attack.checkpoints import load_checkpoint
from cloak_core.attack.events import read_events
from cloak_core.errors import InputError
from cloak_core.scene.exchange import read_colors, read_face_list
from tests.attack import children
from tests.attack.fakes import box_bodies, front_logo

KILLS = int(os.environ.get("CLOAK_KILLS", "10"))
DOCS = Path(__file__).parents[2] / "docs" / "reliability.md"


def loads(folder: Path) -> None:
    """Whatever is there is whole."""
    if not folder.exists():
        return
    json.loads((folder / "config.json").read_text())
    assert (read_face_list(folder / "logo.npy", box_bodies()).ids == front_logo(box_bodies()).face_ids).all()
    if (folder / "colors.npy").exists():
        read_colors(folder / "colors.npy", 16)
    assert load_checkpoint(folder / "checkpoint")[1] == []
    if (folder / "events.jsonl").exists():
        read_events(folder / "events.jsonl")


def test_killed_at_random_moments_and_resumed(tmp_path):
    children.drain(children.start(children.nothing)[1])  # the fork server takes its time to start
    process, pipe = children.start(children.train_and_tell, str(tmp_path / "whole"))
    first = time.perf_counter()
    assert children.drain(pipe)[-1] == -1
    duration = time.perf_counter() - first
    process.join()
    colors = read_colors(tmp_path / "whole" / "colors.npy")
    draw = random.Random(0)
    kills = []
    for number in range(KILLS):
        out = tmp_path / str(number)
        process, pipe = children.start(children.train_and_tell, str(out))
        time.sleep(draw.uniform(0, duration))
        process.kill()
        said = children.drain(pipe)
        process.join()
        kills.append(max(said, default=0) if -1 not in said else children.STEPS)
        loads(out)
        assert np.array_equal(children.whole_run(out).colors, colors)
        steps = [e["step"] for e in read_events(out / "events.jsonl") if e["type"] == "step"]
        assert steps == list(range(1, children.STEPS + 1))
    assert min(kills) < children.STEPS
    if os.environ.get("CLOAK_WRITE_DOCS"):
        write_docs(kills)


def test_a_full_disk_ends_the_run_and_leaves_what_was_there(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(disk)], capture_output=True)
    if mounted.returncode:
        pytest.skip("mounting a small tmpfs is not permitted here")
    try:
        with pytest.raises(InputError, match=r"cannot be written \(No space left on device\)"):
            children.whole_run(disk / "run", lambda event: fill(disk) if event["step"] == 9 else None)
        loads(disk / "run")
        reached, _ = load_checkpoint(disk / "run" / "checkpoint")
        assert reached.step in (8, 9)
        (disk / "ballast").unlink()
        assert np.array_equal(children.whole_run(disk / "run").colors, children.whole_run(tmp_path / "whole").colors)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def fill(disk: Path) -> None:
    with (disk / "ballast").open("ab", buffering=0) as file:
        try:
            while True:
                file.write(bytes(1024))
        except OSError:
            pass


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        children.whole_run(tmp_path / "file" / "run")


def test_the_wall_clock_may_run_backwards(tmp_path, monkeypatch):
    ticks = iter(range(10_000_000, 0, -1))
    monkeypatch.setattr(time, "time", lambda: float(next(ticks)))
    children.whole_run(tmp_path / "run")
    times = [event["time"] for event in read_events(tmp_path / "run" / "events.jsonl")]
    assert times == sorted(times)


def write_docs(kills: list[int]) -> None:
    lines = [
        "# Reliability",
        "",
        "Written by `CLOAK_KILLS=50 CLOAK_WRITE_DOCS=1 pytest tests/attack/test_reliability.py`.",
        "",
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"{time.strftime('%Y-%m-%d')}.",
        "",
        "| what | figure |",
        "|---|---|",
        f"| runs killed (SIGKILL) at a random moment | {len(kills)} |",
        f"| of these before the first step / within the run / after its last step | {sum(k == 0 for k in kills)} / "
        f"{sum(0 < k < children.STEPS for k in kills)} / {sum(k >= children.STEPS for k in kills)} |",
        "| run folders that did not load afterwards | 0 |",
        "| resumed runs whose colours differ in any bit from the uninterrupted run's | 0 |",
        "",
        f"The run: {children.STEPS} steps with a checkpoint, a colour file and an event after each, so that most "
        "moments fall into a write.",
    ]
    DOCS.parent.mkdir(exist_ok=True)
    DOCS.write_text("\n".join(lines) + "\n")
