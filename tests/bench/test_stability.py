"""The stability run finds nothing wrong in any case, and would find it."""

import numpy as np
import pytest
import torch

from cloak_core.bench import hostile_cases, stability, stability_checks


@pytest.mark.parametrize("name", stability.CASES)
def test_no_case_differs(name: str) -> None:
    case = stability.CASES[name](np.random.default_rng(0))
    assert stability.mismatches(case, 1) == 0 and stability.depth_error(case, 40) < 1.01
    assert not (case.areas or case.cover) or stability.area_mismatches(case) == 0


# The million triangles have a test of their own, in test_rasterizer.py.
@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in stability.CHECKS if "million" not in name])
def test_no_check_fails(name: str) -> None:
    found = stability.CHECKS[name]()
    assert found is None if name == "CPU against CUDA" and not torch.cuda.is_available() else found[0] == 0


def test_the_record_adds_up(monkeypatch: pytest.MonkeyPatch) -> None:
    some = {name: stability.CASES[name] for name in ("closed mesh", "image 1 x 1")}
    checks = {"one wrong": lambda: (1, ""), "absent": lambda: None}
    for target, value in (("CASES", some), ("CHECKS", checks), ("HOSTILE", {})):
        monkeypatch.setattr(stability, target, value)
    result = stability.run_bench_stability(grids=(1,), seeds=2)
    assert (result["cases"], result["mismatches"]) == (4 + 4 + 1, 1)
    assert result["by_case"]["absent"]["cases"] == 0 and "not run" in result["by_case"]["absent"]["remark"]


@pytest.mark.parametrize("name", ["shared edges through samples", "closed mesh", "fans of huge triangles"])
def test_a_missing_triangle_is_a_mismatch(name: str) -> None:
    case = stability.CASES[name](np.random.default_rng(0))
    seen = np.unique(stability.rasterize(case.screen, case.triangles).triangles().numpy())
    keep = np.setdiff1d(np.arange(case.triangles.shape[1]), seen[-1:])
    broken = stability.Case(case.screen, case.triangles[:, keep], case.cover, case.front_only, case.cull)
    assert stability.mismatches(broken, 1) > 0 and stability.area_mismatches(broken) > 0


@pytest.mark.parametrize(
    ("make", "count"),
    [
        (hostile_cases.needles, 300),
        (hostile_cases.hairs, 300),
        (hostile_cases.planes, 50),
        (hostile_cases.specks, 5000),
    ],
)
def test_hostile_scenes_keep_their_coverage(make: object, count: int) -> None:
    wrong, remark = hostile_cases.check(make, count)
    assert wrong == 0 and ("0 of" in remark) == (make is not hostile_cases.specks)


def test_a_row_of_pixels_takes_bounded_time() -> None:
    def thread(rng: np.random.Generator, count: int) -> hostile_cases.Triangles:
        """Needles across two rows of pixels."""
        x, y, depth = hostile_cases.needles(rng, count)
        return x, 100 + y % 2, depth

    wrong, remark = hostile_cases.check(thread, 2000)
    assert wrong == 0 and 100 < int(remark.split()[2]) < 832


def test_light_that_is_off_is_a_mismatch(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = stability_checks.TwinLight.__call__
    off = lambda self, *where: tuple(value + 2e-4 for value in twin(self, *where))
    monkeypatch.setattr(stability_checks.TwinLight, "__call__", off)
    assert stability_checks.precision()[0] > 100
