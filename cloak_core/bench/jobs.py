"""`cloak bench jobs`: what handing work out costs, and what a thousand or a hundred thousand trainings would take."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from cloak_core.bench.records import table
from cloak_core.bench.views import machine
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json
from cloak_core.jobs.job import Job, Outcome, in_order

FLEETS = ((1_000, 64), (100_000, 64), (100_000, 2_048))
"""Trainings, and cores that share them."""
DAY = 86_400.0


def nothing(number: int) -> int:
    """Do a job's work that takes no time."""
    return number


def run_bench_jobs(
    *, count: int, train_seconds: float, evaluate_seconds: float, megabytes: float, files: int, ray: bool = True
) -> dict:
    """{"in_order_ms", "ray_ms", "results_ms", "plan", ...}: milliseconds for each of `count` jobs that do nothing (Ray:
    on this machine's own cluster, its start not counted; None without it), and for writing and reading the result of
    one; then what so long a training and evaluation, on one core each, come to.

    megabytes, files: that a run leaves on disk. InputError: no jobs.
    """
    if count < 1 or train_seconds <= 0:
        raise InputError(f"count {count}, train-seconds {train_seconds}: at least 1 job that takes time")
    record = {"in_order_ms": _per_job(in_order, count), "ray_ms": _by_ray(count) if ray else None}
    record |= {"results_ms": _results(count), "count": count, "files": files, "megabytes": megabytes}
    record |= {"train_seconds": train_seconds, "evaluate_seconds": evaluate_seconds}
    return record | {"plan": [_planned(record, *fleet) for fleet in FLEETS], "machine": machine()}


def _per_job(run: Callable[[Sequence[Job]], Iterator[Outcome]], count: int) -> float:
    jobs = [Job(str(number), nothing, {"number": number}, cores=0.01) for number in range(count)]
    started = time.perf_counter()
    done = sum(1 for _ in run(jobs))
    if done != count:
        raise RuntimeError(f"{done} of {count} jobs came back")
    return 1000 * (time.perf_counter() - started) / count


def _by_ray(count: int) -> float:
    import ray

    from cloak_core.jobs.ray_cluster import LOCAL, RayCluster

    cores = os.cpu_count() or 1
    ray.init(num_cpus=cores, include_dashboard=False, log_to_driver=False, logging_level="error")
    try:
        _per_job(RayCluster(LOCAL).run, 2 * cores)  # starts the workers
        return _per_job(RayCluster(LOCAL).run, count)
    finally:
        ray.shutdown()


def _results(count: int) -> float:
    """Time, in milliseconds, writing and once reading what is recorded of a run."""
    record = {"name": "run", "varied": {"seed": 0}, "step": 600, "seconds": 1.0, "loss": 0.1, "success": 1.0}
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder, f"{number}.json") for number in range(count)]
        started = time.perf_counter()
        for path in paths:
            write_json(path, record)
        for path in paths:
            read_json(path)
        return 1000 * (time.perf_counter() - started) / count


def _planned(record: dict, trainings: int, cores: int) -> dict:
    """Estimate the cost of many trainings from what was measured."""
    each = record["train_seconds"] + record["evaluate_seconds"]
    overhead = (max(record["ray_ms"] or 0.0, record["in_order_ms"]) + record["results_ms"]) / 1000
    return {
        "trainings": trainings,
        "cores": cores,
        "days": round(trainings * each / cores / DAY, 2),
        "handing_out_hours": round(trainings * overhead / 3600, 2),
        # Beyond these the process that hands out is what everybody waits for.
        "most_cores": int(each / overhead),
        "gigabytes": round(trainings * record["megabytes"] / 1000, 1),
        "files": trainings * record["files"],
    }


def jobs_table(result: dict) -> list[str]:
    """Lines of Markdown: the plan."""
    head = ("trainings", "cores", "days", "handing out", "disk", "files", "cores that one can feed")
    line = "{trainings:,}|{cores:,}|{days:g}|{handing_out_hours:g} h|{gigabytes:,.0f} GB|{files:,}|{most_cores:,}"
    return table(head, [line.format(**plan).split("|") for plan in result["plan"]])
