"""How benchmarks take time, describe the machine, and keep their records."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_text


def timed_in_turn(
    works: Mapping[str, Callable[[int], object]],
    repeats: int,
    device: str = "cpu",
    warm_up: int = 3,
    now: Callable[[], float] = time.perf_counter,
) -> dict[str, list[float]]:
    """Milliseconds of `repeats` runs of each work, after `warm_up` that do not count.

    The works take turns, so that whatever else the machine does hits all of them. Each is handed the round's number.
    """
    wait = torch.cuda.synchronize if str(device).startswith("cuda") else lambda: None
    times: dict[str, list[float]] = {name: [] for name in works}
    for number in range(warm_up + repeats):
        for name, work in works.items():
            wait()
            start = now()
            work(number)
            wait()
            if number >= warm_up:
                times[name].append((now() - start) * 1e3)
    return times


def timed(work: Callable[[], object], repeats: int, device: str = "cpu", warm_up: int = 3) -> dict[str, float]:
    """Median and least milliseconds of `repeats` runs of `work`, after some that do not count; see `clock`."""
    now = time.process_time if clock(device) == "processor" else time.perf_counter
    times = timed_in_turn({"work": lambda number: work()}, repeats, device, warm_up, now)["work"]
    return {"median": float(np.median(times)), "min": float(min(times))}


def clock(device: str = "cpu") -> str:
    """Which time is measured: with one thread on the CPU the processor's, in which what else the machine does counts
    for little; else the wall's, as threads and devices wait for each other."""
    return "processor" if str(device).startswith("cpu") and torch.get_num_threads() == 1 else "wall"


def machine(device: str = "cpu") -> dict[str, str]:
    """Describe what the figures were measured on."""
    name = platform.processor() or platform.machine()
    if str(device).startswith("cuda"):
        name = torch.cuda.get_device_name()
    elif os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            models = (line.split(":", 1)[1].strip() for line in file if line.startswith("model name"))
            name = next(models, name)
    return {
        "date": time.strftime("%Y-%m-%d"),
        "device": name,
        "cores": str(os.cpu_count()),
        "torch": torch.__version__,
        "python": platform.python_version(),
    }


def check_counts(repeats: int, threads: int) -> None:
    """InputError: nothing is to be repeated, or no thread may do it."""
    if repeats < 1 or threads < 1:
        raise InputError(f"repeats {repeats}, threads {threads}: at least 1 each")


def write_rows(path: Path, rows: Iterable[Mapping], machine: Mapping[str, str]) -> None:
    """Write rows of figures as CSV, the machine beside each; the keys of nested figures are joined by "_"."""
    table = pd.json_normalize([dict(row) | dict(machine) for row in rows], sep="_")
    write_text(path, table.to_csv(index=False, lineterminator="\n"))
