"""What a detector costs: forward, and forward with the gradient of the images, against the same model used naively."""

import logging
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

import torch

from cloak_core.bench.measuring import machine, timed_in_turn, write_rows
from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.core.visibility.threads import torch_threads
from cloak_core.detectors.loading import load_detector
from cloak_core.jobs.job import Tell
from cloak_core.studies.pace import in_turn
from cloak_core.studies.report.words import short_name

_log = logging.getLogger(__name__)


def run_bench_detectors(
    specs: Sequence[str],
    *,
    batch: int = 4,
    size: int = 416,
    repeats: int = 9,
    threads: int | None = None,
    device: str = "cpu",
    tell: Tell = _log.info,
    **options: object,
) -> dict[str, dict[str, float]]:
    """Median milliseconds per image, for `batch` images of `size` x `size` (noise: the work does not depend on it).

    Per spec: {"forward_ms", "gradient_ms": forward and input gradient, "naive_ms": the same with batch norm unfolded,
    the memory layout as loaded, in float32, and gradients for the weights, "speedup": naive_ms / gradient_ms, "batch",
    "threads"}.
    The two ways take turns, so that both meet the same machine. A black box has no gradients: those entries are absent.
    `tell` hears of each detector before it is timed; `options` go to `load_detector`.
    """
    images = torch.rand(batch, 3, size, size, generator=torch.Generator().manual_seed(0)).to(device)
    with torch_threads(threads or torch.get_num_threads()):
        detectors = {spec: load_detector(spec, device=device, **options) for spec in specs}
        turns = in_turn(list(detectors), lambda spec: f"{short_name(spec)}, {repeats} repetitions", tell)
        return {spec: _bench(detectors[spec], spec, images, repeats, device, options) for spec in turns}


def _bench(
    detector: Detector, spec: str, images: torch.Tensor, repeats: int, device: str, options: dict
) -> dict[str, float]:
    @torch.no_grad()
    def forward(number: int) -> None:
        max_person_score(detector(images))

    def gradient(network: Detector) -> Callable[[int], None]:
        def run(number: int) -> None:
            network.zero_grad(set_to_none=True)
            max_person_score(network(images.clone().requires_grad_())).sum().backward()

        return run

    ways = {"forward_ms": forward}
    if detector.differentiable:
        plain = {name: value for name, value in options.items() if name not in ("precision", "compiled")}
        naive = load_detector(spec, device=device, fold=False, **plain).requires_grad_(True)
        ways |= {"gradient_ms": gradient(detector), "naive_ms": gradient(naive)}
    times = timed_in_turn(ways, repeats, device, warm_up=1)
    result = {name: statistics.median(values) / len(images) for name, values in times.items()}
    if "naive_ms" in result:
        result["speedup"] = result["naive_ms"] / result["gradient_ms"]
    return result | {"batch": len(images), "threads": torch.get_num_threads()}


def write_table(results: dict[str, dict[str, float]], path: Path, device: str = "cpu") -> None:
    """Write the figures of `run_bench_detectors` as CSV, a row for each detector with machine, versions and date."""
    write_rows(path, ({"detector": short_name(spec)} | figures for spec, figures in results.items()), machine(device))
