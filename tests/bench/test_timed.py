"""`cloak bench step`, `views`, `detectors` and `gpu`: what they time, and that torch is left as it was."""

import json
from pathlib import Path

import pandas as pd
import pytest
import torch

from benchmarks import gpu
from benchmarks.growth import sphere
from cloak_core.bench import detectors
from cloak_core.bench.step import run_bench_step, write_table
from cloak_core.bench.views import run_bench_views
from cloak_core.commands import bench
from cloak_core.core.cameras import Camera
from cloak_core.core.settings import make_settings
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import load_people
from tests.core.fakes import TinyDetector, box_bodies, front_logo, noise_backgrounds, tiny_settings
from tests.detectors.helpers import write_tiny
from tests.sources.photographs.made_people import write_people


def measure(**changes):
    bodies = box_bodies()
    how = {"logo_faces": front_logo(bodies).face_ids, "settings": tiny_settings(**changes), "threads": 1, "repeats": 3}
    return run_bench_step(bodies, [TinyDetector(0), TinyDetector(1)], noise_backgrounds(), **how)


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, {"distance": "1.8:3"}])
def test_the_record_holds_together(changes, tmp_path):
    before = torch.get_num_threads()
    result = measure(**changes)
    assert torch.get_num_threads() == before
    write_table(result, tmp_path / "step.csv")
    assert pd.read_csv(tmp_path / "step.csv")["step_ms"].tolist() == [result[f"tiny:{k}"]["step_ms"] for k in (0, 1)]
    for spec in ("tiny:0", "tiny:1"):
        row = result[spec]
        assert row["batch"] == 3 and row["floor_ms"] > 0
        assert row["ratio"] == pytest.approx(row["step_ms"] / row["floor_ms"], rel=0.01)
        assert row["overhead_ms_per_image"] == pytest.approx((row["step_ms"] - row["floor_ms"]) / 3, abs=0.01)


@pytest.mark.slow
def test_people_in_photographs_are_fresh_views_with_a_cloth(tmp_path):
    people = Crowd(load_people(write_people(tmp_path, 1)))
    settings = make_settings("photographs", batch=2, size=64, translation=5)
    bodies = load_scene("sample[0:1]")
    one = run_bench_step(
        bodies, [TinyDetector(0)], noise_backgrounds(), settings=settings, people=people, threads=1, repeats=2
    )["tiny:0"]
    assert one["views"] == "fresh" and one["batch"] == 2 and one["colors"] == 100 * 100
    assert one["step_ms"] > one["floor_ms"]


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
    result = detectors.run_bench_detectors([spec], batch=2, size=64, repeats=2, threads=1)
    figures = result[spec]
    assert set(figures) == {"forward_ms", "gradient_ms", "naive_ms", "speedup", "batch", "threads"}
    assert min(figures.values()) > 0 and figures["threads"] == 1 and torch.get_num_threads() == threads
    assert figures["speedup"] == pytest.approx(figures["naive_ms"] / figures["gradient_ms"])
    detectors.write_table(result, tmp_path / "speed.csv")
    (row,) = pd.read_csv(tmp_path / "speed.csv").to_dict("records")
    assert {"detector": "darknet tiny", "torch": torch.__version__}.items() | figures.items() <= row.items()


@pytest.mark.slow
def test_without_a_device_every_part_is_said_to_be_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    record = gpu.run_bench_gpu(out=tmp_path / "gpu.json")
    assert record["not_run"] == dict.fromkeys(gpu.PARTS, "no CUDA device") and not record["measured"]
    assert json.loads((tmp_path / "gpu.json").read_text()) == json.loads(json.dumps(record))


@pytest.mark.slow
def test_a_part_that_fails_is_named_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(material: gpu.BenchMaterial) -> dict:
        raise InputError("no room")

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(gpu, "machine", lambda device: {})
    monkeypatch.setattr(gpu, "PARTS", {"one": refuse, "other": lambda material: {"ms": 1.0}})
    record = gpu.run_bench_gpu()
    assert record["failed"] == {"one": "no room"} and record["measured"] == {"other": {"ms": 1.0}}


def test_a_wheel_says_that_developers_benchmarks_need_a_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert bench.developers_benchmark("gpu") is gpu
    monkeypatch.setattr(bench, "__file__", str(tmp_path / "cloak_core" / "commands" / "bench.py"))
    with pytest.raises(InputError, match="cloak bench gpu: runs in a checkout"):
        bench.developers_benchmark("gpu")
