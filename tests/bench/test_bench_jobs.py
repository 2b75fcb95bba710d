"""What handing work out costs."""

import pytest

from cloak_core.bench.jobs import DAY, jobs_table, run_bench_jobs
from cloak_core.files.errors import InputError


def test_a_plan_follows_from_what_was_measured():
    told = run_bench_jobs(count=5, train_seconds=700.0, evaluate_seconds=164.0, megabytes=10.0, files=30, ray=False)
    assert told["ray_ms"] is None and told["in_order_ms"] > 0 and told["results_ms"] > 0
    small, large, wide = told["plan"]
    assert small["days"] == pytest.approx(864 * 1000 / 64 / DAY, abs=0.01) and small["gigabytes"] == 10
    assert large["files"] == 3_000_000 and large["days"] > 90 * small["days"] > wide["days"]
    each = (told["in_order_ms"] + told["results_ms"]) / 1000
    assert small["most_cores"] == int(864 / each)
    assert len(jobs_table(told)) == 5
    with pytest.raises(InputError, match="at least 1 job"):
        run_bench_jobs(count=0, train_seconds=1.0, evaluate_seconds=0.0, megabytes=1.0, files=1, ray=False)
