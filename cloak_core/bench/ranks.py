"""`cloak bench ranks`: training in several processes beside one process, with the same number of threads together."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from cloak_core.attack.events import read_events
from cloak_core.bench.views import machine
from cloak_core.files.errors import InputError


def run_bench_ranks(
    spec: str,
    scene: str,
    logo: Path,
    backgrounds: str,
    *,
    batch: int,
    ranks: int,
    threads: int,
    steps: int,
    rounds: int,
) -> dict:
    """{SPEC: {"batch", "ranks", "threads", "one", "many", "throughput", ...}}: images a second, and many / one.

    `cloak train` itself, alone and under torchrun, takes turns for `rounds`; medians. The first third of the steps
    builds views and warms up, and is not counted. InputError: threads that do not divide, or a training that fails.
    """
    if ranks < 2 or threads % ranks or steps < 3 or rounds < 1:
        raise InputError(
            f"ranks {ranks}, threads {threads}, steps {steps}: at least 2 ranks, 3 steps, and equal shares"
        )
    options = ["--scene", scene, "--logo", str(logo), "--backgrounds", backgrounds, "--detector", spec]
    options += ["--batch", str(batch), "--steps", str(steps), "--checkpoint-every", "0", "--preview-every", "0"]
    rates: dict[int, list[float]] = {1: [], ranks: []}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            for count, found in rates.items():
                out = Path(folder, f"{number}-{count}")
                found.append(batch * _steps_per_second(count, threads // count, [*options, "--out", str(out)], out))
    one, many = (statistics.median(rates[count]) for count in (1, ranks))
    return {
        spec: {
            "batch": batch,
            "ranks": ranks,
            "threads": threads,
            "one": round(one, 2),
            "many": round(many, 2),
            "throughput": round(many / one, 4),
            "all": {str(count): [round(rate, 2) for rate in found] for count, found in rates.items()},
        },
        "machine": machine(),
    }


def _steps_per_second(count: int, threads: int, options: list[str], out: Path) -> float:
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(count)] if count > 1 else []
    command = [sys.executable, *launcher, "-m", "cloak_core", "train", *options, "--threads", str(threads)]
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        words = [line for line in done.stderr.splitlines() if line.startswith("cloak: ")]
        raise InputError(words[-1].removeprefix("cloak: ") if words else f"training failed: {done.stderr[-300:]!r}")
    times = [event["time"] for event in read_events(out / "events.jsonl") if event["type"] == "step"]
    warm = len(times) // 3
    return (len(times) - 1 - warm) / (times[-1] - times[warm])
