"""The accuracy run: its record, and that the default is where the README says it is."""

import numpy as np
import pytest

from cloak_core.bench import accuracy
from cloak_core.bench.accuracy_report import pareto, tables
from cloak_core.bench.growth import exponent, sphere
from cloak_core.scene.bodies import is_closed, is_outward
from cloak_core.scene.cameras import Camera


@pytest.fixture(scope="module")
def record() -> dict:
    scene = accuracy.Scene(sphere(1500, 0.5), Camera(width=64, height=64, distance=2.5))
    return accuracy.measure(scene, repeats=1)


def test_every_number_of_samples_and_areas_are_measured(record) -> None:
    names = [point["name"] for point in record["points"]]
    assert names == ["ours-1", "ours-4", "ours-16", "ours-64", "ours-area"]
    for point in record["points"]:
        assert set(accuracy.COLUMNS) < set(point) and all(np.isfinite(point[key]) for key in accuracy.COLUMNS)


def test_errors_fall_with_samples_and_areas_keep_every_gradient(record) -> None:
    points = {point["name"]: point for point in record["points"]}
    for column in ("image_rms", "coverage_rms", "gradient_smooth", "gradient_white", "starved"):
        one, four, sixteen = (points[f"ours-{n}"][column] for n in (1, 4, 16))
        assert one > four > sixteen >= points["ours-area"][column]
    default = points[accuracy.DEFAULT]
    assert default["image_rms"] < 1 / 255 and default["gradient_smooth"] < 0.05 and default["starved"] == 0


def test_report_and_front(record) -> None:
    result = {"scenes": {"ball": record}, "default": accuracy.DEFAULT, "threads": 1, "repeats": 1}
    text = tables(result | {"machine": {"device": "a machine", "torch": "2", "python": "3"}})
    assert "**ours-area**" in text and text.count("\n| ") == 6
    made = [{"new_view_ms": t, "gradient_smooth": e} for t, e in ((1, 0.5), (2, 0.6), (3, 0.1), (4, 0.1))]
    assert pareto(made) == [made[0], made[2]]


def test_growth_fits_exponents_and_its_bodies_are_closed() -> None:
    points = [{"size": n, "seconds": 0.1 * n**1.5} for n in (10, 40, 160, 640)]
    assert exponent(points) == pytest.approx(1.5) and exponent(points, 2) == pytest.approx(0.75)
    body = sphere(3000)
    assert is_closed(body.triangles) and is_outward(body).all() and abs(body.triangle_count / 3000 - 1) < 0.1
