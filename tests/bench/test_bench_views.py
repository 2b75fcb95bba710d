"""`cloak bench views`: every way to build a view is timed, alone and in a batch."""

import pytest

from cloak_core.bench.growth import sphere
from cloak_core.bench.views import run_bench_views
from cloak_core.core.cameras import Camera
from cloak_core.sources.bodies.people.samples import sample_bodies


@pytest.mark.slow
@pytest.mark.parametrize("way", [4, "area"])
def test_one_way_is_timed_alone(way: object) -> None:
    result = run_bench_views(sphere(80), samples=way, threads=1, repeats=1, camera=Camera(width=24, height=24))
    assert result["samples"] == way and set(result["by_samples"]) == {str(way)}
    assert min(result[name]["min"] for name in ("visibility_ms", "new_view_ms", "cached_ms")) > 0


@pytest.mark.long
def test_every_number_of_samples_is_timed() -> None:
    camera = Camera(width=48, height=64)
    result = run_bench_views(sample_bodies(), threads=1, repeats=1, camera=camera)
    assert result["samples"] == 1
    for name in ("visibility_ms", "new_view_ms", "cached_ms"):
        assert 0 < result[name]["min"] <= result[name]["median"]
    assert set(result["by_samples"]) == {"1", "4", "16", "64", "area"}
    for row in result["by_samples"].values():
        assert row["visibility_ms"] > 0 and row["new_view_batch_ratio"] > 1
