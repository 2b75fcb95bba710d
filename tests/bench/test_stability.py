"""The stability run finds nothing wrong, and would find it."""

import numpy as np
import pytest

from cloak_core.bench import stability


def test_no_mismatch_in_any_case() -> None:
    result = stability.run_bench_stability(grids=(1,), seeds=1)
    assert result["mismatches"] == 0, result["by_case"]
    assert result["cases"] == len(result["by_case"]) >= 20
    assert result["max_error_ulp"] < 1.01


@pytest.mark.parametrize("name", ["shared edges through samples", "closed mesh", "fans of huge triangles"])
def test_a_missing_triangle_is_a_mismatch(name: str) -> None:
    case = stability.CASES[name](np.random.default_rng(0))
    whole = stability.mismatches(case, 1)
    seen = np.unique(stability.rasterize(case.screen, case.triangles).triangles().numpy())
    keep = np.setdiff1d(np.arange(case.triangles.shape[1]), seen[-1:])
    broken = stability.Case(case.screen, case.triangles[:, keep], case.cover, case.front_only, case.cull)
    assert whole == 0 and stability.mismatches(broken, 1) > 0
