"""The detector benchmark: its keys and that it leaves torch as it was. Speeds are for the command, not for tests."""

from pathlib import Path

import pandas as pd
import pytest
import torch

from cloak_core.bench.detectors import run_bench_detectors, write_table
from tests.detectors.helpers import write_tiny


def test_bench_measures_both_ways(tmp_path: Path) -> None:
    spec, threads = write_tiny(tmp_path), torch.get_num_threads()
    result = run_bench_detectors([spec], batch=2, size=64, repeats=2, threads=1)[spec]
    assert set(result) == {"forward_ms", "gradient_ms", "naive_ms", "speedup", "batch", "threads"}
    assert min(result.values()) > 0 and result["threads"] == 1 and torch.get_num_threads() == threads
    assert result["speedup"] == pytest.approx(result["naive_ms"] / result["gradient_ms"])


def test_the_table_holds_what_was_measured(tmp_path: Path) -> None:
    spec = write_tiny(tmp_path)
    result = run_bench_detectors([spec], batch=2, size=64, repeats=1, threads=1)
    write_table(result, tmp_path / "speed.csv")
    (row,) = pd.read_csv(tmp_path / "speed.csv").to_dict("records")
    assert {"detector": "darknet tiny", "torch": torch.__version__}.items() | result[spec].items() <= row.items()
