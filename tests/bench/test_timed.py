"""`cloak bench views` and `detectors`: what they time, and that torch is left as it was."""

from pathlib import Path

import pandas as pd
import pytest
import torch

from cloak_core.bench.detectors import run_bench_detectors, write_table
from cloak_core.bench.growth import sphere
from cloak_core.bench.views import run_bench_views
from cloak_core.core.cameras import Camera
from tests.detectors.helpers import write_tiny


@pytest.mark.slow
@pytest.mark.parametrize("way", [4, "area", None])
def test_every_way_to_build_a_view_is_timed(way: object) -> None:
    result = run_bench_views(sphere(80), samples=way, threads=1, repeats=1, camera=Camera(width=24, height=24))
    assert result["samples"] == (way or 1)
    assert set(result["by_samples"]) == ({str(way)} if way else {"1", "4", "16", "64", "area"})
    for name in ("visibility_ms", "new_view_ms", "cached_ms"):
        assert 0 < result[name]["min"] <= result[name]["median"]
    assert all(row["visibility_ms"] > 0 and row["new_view_batch_ratio"] > 1 for row in result["by_samples"].values())


def test_both_ways_to_run_a_detector_are_timed(tmp_path: Path) -> None:
    spec, threads = write_tiny(tmp_path), torch.get_num_threads()
    result = run_bench_detectors([spec], batch=2, size=64, repeats=2, threads=1)
    figures = result[spec]
    assert set(figures) == {"forward_ms", "gradient_ms", "naive_ms", "speedup", "batch", "threads"}
    assert min(figures.values()) > 0 and figures["threads"] == 1 and torch.get_num_threads() == threads
    assert figures["speedup"] == pytest.approx(figures["naive_ms"] / figures["gradient_ms"])
    write_table(result, tmp_path / "speed.csv")
    (row,) = pd.read_csv(tmp_path / "speed.csv").to_dict("records")
    assert {"detector": "darknet tiny", "torch": torch.__version__}.items() | figures.items() <= row.items()
