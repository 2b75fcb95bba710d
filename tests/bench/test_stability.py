"""The stability run finds nothing wrong in any case, and would find it."""

import numpy as np
import pytest
import torch

from cloak_core.bench import stability
from cloak_core.bench.oracle import screen_of
from cloak_core.core.view import Window
from cloak_core.core.visibility.rasterizer import area_fragments
from cloak_core.core.visibility.screen import GRID


@pytest.mark.long
@pytest.mark.parametrize("name", stability.CASES)
def test_no_case_differs(name: str) -> None:
    case = stability.CASES[name](np.random.default_rng(0))
    assert stability.mismatches(case, 1) == 0 and stability.depth_error(case, 40) < 1.01
    assert not (case.areas or case.cover) or stability.area_mismatches(case) == 0


# The million triangles have a test of their own, in test_rasterizer.py.
@pytest.mark.long
@pytest.mark.parametrize("name", [n for n in stability.CHECKS if not n.startswith(("a million", "hostile"))])
def test_no_check_fails(name: str) -> None:
    found = stability.CHECKS[name]()
    assert found is None if name == "CPU against CUDA" and not torch.cuda.is_available() else found[0] == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["shared edges through samples", "closed mesh", "fans of huge triangles"])
def test_a_missing_triangle_is_a_mismatch(name: str) -> None:
    case = stability.CASES[name](np.random.default_rng(0))
    seen = np.unique(stability.rasterize(case.screen, case.triangles).triangles().numpy())
    keep = np.setdiff1d(np.arange(case.triangles.shape[1]), seen[-1:])
    broken = stability.Case(case.screen, case.triangles[:, keep], case.cover, case.front_only, case.cull)
    assert stability.mismatches(broken, 1) > 0 and stability.area_mismatches(broken) > 0


@pytest.mark.slow
@pytest.mark.parametrize(("make", "count"), [(stability.needles, 300), (stability.specks, 5000)])
def test_hostile_scenes_keep_their_coverage(make: object, count: int) -> None:
    wrong, remark = stability.crowded(make, count)
    assert wrong == 0 and ("0 of" in remark) == (make is stability.needles)


def crossing(rng: np.random.Generator, count: int) -> stability.Triangles:
    """Needles in two rows of pixels."""
    x, y, depth = stability.needles(rng, count)
    return x, 100 + y % 2, depth


@pytest.mark.filterwarnings("ignore::cloak_core.core.view.CrowdedPixels")
def test_what_is_sampled_does_not_depend_on_how_rows_are_shared() -> None:
    x, y, depth = crossing(np.random.default_rng(0), 1200)
    corners = (np.rint(t * GRID).astype(np.int64).ravel() for t in (x, y))
    screen, triangles = screen_of(*corners, depth.ravel(), 416, 416), torch.arange(x.size).view(-1, 3).T.contiguous()
    areas = lambda top, bottom: area_fragments(screen, triangles, None, Window(0, top, 416, bottom)).area
    assert torch.equal(areas(100, 102), torch.cat([areas(100, 101), areas(101, 102)]))


@pytest.mark.slow
def test_the_record_adds_up(monkeypatch: pytest.MonkeyPatch) -> None:
    some = {name: stability.CASES[name] for name in ("closed mesh", "image 1 x 1")}
    checks = {"one wrong": lambda: (1, ""), "absent": lambda: None}
    monkeypatch.setattr(stability, "CASES", some)
    monkeypatch.setattr(stability, "CHECKS", checks)
    monkeypatch.setattr(stability, "area_mismatches", lambda case: int(case.has_areas))
    result = stability.run_bench_stability(grids=(1,), seeds=2)
    assert (result["cases"], result["mismatches"]) == (6 + 4 + 1, 2 + 1)
    assert result["by_case"]["absent"]["cases"] == 0 and "not run" in result["by_case"]["absent"]["remark"]


def test_light_that_is_off_is_a_mismatch(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = stability.TwinLight.__call__
    off = lambda self, *where: tuple(value + 2e-4 for value in twin(self, *where))
    monkeypatch.setattr(stability.TwinLight, "__call__", off)
    assert stability.precision()[0] > 100
