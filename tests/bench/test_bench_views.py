"""`cloak bench views`: every way to build a view is timed, alone and in a batch."""

import pytest

from cloak_core.bench.views import run_bench_views
from cloak_core.scene.cameras import Camera
from cloak_core.scene.people.samples import sample_bodies


@pytest.mark.long
def test_every_number_of_samples_is_timed() -> None:
    camera = Camera(width=48, height=64)
    result = run_bench_views(sample_bodies(), samples=4, threads=1, repeats=1, camera=camera)
    assert result["samples"] == 4
    for name in ("visibility_ms", "new_view_ms", "stored_ms", "cached_ms"):
        assert 0 < result[name]["min"] <= result[name]["median"]
    assert set(result["by_samples"]) == {"1", "4", "16", "64", "area"}
    for row in result["by_samples"].values():
        assert row["visibility_ms"] > 0 and row["new_view_batch_ratio"] > 1
