"""The accuracy run: its record and report, and that the default is where the README says it is."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import accuracy
from benchmarks.accuracy import FLAT, write_report
from benchmarks.growth import sphere
from benchmarks.peers import PEERS
from cloak_core.bench.reference import EXACT, reference
from cloak_core.core.cameras import Camera
from cloak_core.core.visibility.settings import Light, RenderSettings
from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.view_cache import ViewCache


@pytest.fixture(scope="module")
def record() -> dict:
    scene = accuracy.Scene(sphere(1500, 0.5), Camera(width=64, height=64, distance=2.5))
    return accuracy.measure(scene, 1, 1, {kind.module: "missing: not asked for" for kind in PEERS})


def test_errors_fall_with_samples_and_areas_keep_every_gradient(record) -> None:
    points = {point["name"]: point for point in record["points"]}
    assert list(points) == ["ours-1", "ours-4", "ours-16", "ours-64", "ours-area"] and record["reference"] == EXACT
    assert all(
        min(point[f"{name}_ms"] for name in ("visibility", "new_view", "cached")) > 0 for point in points.values()
    )
    for column in ("image_rms", "coverage_rms", "gradient_smooth", "gradient_white", "starved"):
        one, four, sixteen = (points[f"ours-{n}"][column] for n in (1, 4, 16))
        assert one > four > sixteen >= points["ours-area"][column]
    default = points[accuracy.default_name()]
    assert default["image_rms"] < 1 / 255 and default["gradient_smooth"] < 0.05 and default["starved"] == 0


@pytest.mark.slow
def test_report_keeps_what_was_measured_before(record, tmp_path: Path) -> None:
    for scene in ("distant", "bench"):
        write_report({"scenes": {scene: record}, "default": "ours-area"}, tmp_path)
    assert list(json.loads((tmp_path / "accuracy.json").read_text())["scenes"]) == ["bench", "distant"]
    assert (tmp_path / "accuracy.png").stat().st_size > 1000
    (tmp_path / "accuracy.json").write_text("[]")
    with pytest.raises(InputError, match="earlier run"):
        write_report({"scenes": {}, "default": "ours-area"}, tmp_path)


@pytest.mark.parametrize("name", ["shell-1mm", "garment", "cards"])
def test_scenes_of_overlapping_surfaces_are_exact_by_area_and_leak_by_samples(name: str) -> None:
    scene = accuracy.make_scene(name, sphere(300, 0.9))
    camera = dataclasses.replace(scene.camera, width=24, height=24)
    scene = accuracy.Scene(scene.bodies, camera)
    judge = accuracy.Judge(scene, reference(scene.bodies, camera, Light()))
    ours, four = (
        judge.errors(*(ViewCache(scene.bodies, RenderSettings(light=kind, samples=n)) for kind in (Light(), FLAT)))
        for n in (None, 4)
    )
    assert max(ours["coverage_rms"], ours["hidden"]) < 1e-6 and ours["starved"] == ours["given_up"] == 0
    assert max(ours["image_visibility"], ours["gradient_visibility"]) < 2e-5 < four["image_visibility"]


@pytest.mark.parametrize("name", [name for name in accuracy.SCENES if name != "million"])
def test_every_scene_is_made(name: str) -> None:
    made = accuracy.make_scene(name, sphere(100)).bodies
    assert made.triangle_count >= 80 and np.isfinite(made.vertices).all()


def test_unknown_scene_is_named() -> None:
    with pytest.raises(InputError, match="'moon'"):
        accuracy.run_bench_accuracy(sphere(100), only=("moon",))
