"""The growth run: its bodies, its fit, one series measured in processes of its own, and its report."""

import json
from pathlib import Path

import pytest

from cloak_core.bench import growth
from cloak_core.core.geometry import outward_parts
from cloak_core.files.errors import InputError
from tests.sources.bodies.solids import is_closed


def test_exponents_are_slopes_of_the_last_three_points() -> None:
    points = [{"size": n, "seconds": 0.1 * n**1.5, "working_mib": 3.0 * n} for n in (10, 40, 160, 640)]
    points[0]["seconds"] = 99.0
    assert growth.exponents(points) == pytest.approx({"exponent": 1.5, "memory_exponent": 1.0})
    assert growth.exponents(points, 2)["exponent"] == pytest.approx(0.75)


def test_its_bodies_are_closed() -> None:
    body = growth.sphere(3000)
    assert is_closed(body.triangles) and outward_parts(body).all() and abs(body.triangle_count / 3000 - 1) < 0.1


@pytest.mark.slow
def test_a_point_is_measured_in_a_process_of_its_own() -> None:
    """With a budget that holds one view: the others are dropped, nothing fails."""
    point = growth._measured(growth.Work(500, views=3, side=32), 3, threads=1, memory=1)
    assert point["size"] == 3 and point["seconds"] > 0 and point["peak_mib"] > 50


def test_series_join_those_measured_before(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made = lambda work, size, threads, memory: {
        "size": size,
        "seconds": size,
        "working_mib": 2 * size,
        "peak_mib": 3 * size,
    }
    monkeypatch.setattr(growth, "_measured", made)
    for name in ("views", "pixels"):
        result = growth.run_bench_growth(threads=1, only=(name,), out=tmp_path)
    assert json.loads((tmp_path / "growth.json").read_text()) == result
    assert result["exponents"] == pytest.approx({"views": 1.0, "pixels": 0.5})


def test_bad_input() -> None:
    with pytest.raises(InputError, match="'moons'"):
        growth.run_bench_growth(only=("moons",))
    with pytest.raises(InputError, match="0 bytes"):
        growth.run_bench_growth(memory=0)
