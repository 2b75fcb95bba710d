"""The growth run: its bodies, its fit, one series measured in processes of its own, and its report."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import growth
from benchmarks.growth import grow_people, grow_step, write_simulated
from cloak_core.files.errors import InputError
from cloak_core.sources.photographs.people import load_people
from tests.sources.photographs.made_people import write_people


def test_exponents_are_slopes_of_the_last_three_points() -> None:
    points = [{"size": n, "seconds": 0.1 * n**1.5, "working_mib": 3.0 * n} for n in (10, 40, 160, 640)]
    points[0]["seconds"] = 99.0
    assert growth.exponents(points) == pytest.approx({"exponent": 1.5, "memory_exponent": 1.0})
    assert growth.exponents(points, 2)["exponent"] == pytest.approx(0.75)


@pytest.mark.slow
def test_a_point_is_measured_in_a_process_of_its_own() -> None:
    """With a budget that holds no view: it is dropped, nothing fails."""
    point = growth.measure("pixels", 32, threads=1, memory=1)
    assert point["size"] == 32 and point["seconds"] > 0 and point["peak_mib"] > 50


@pytest.mark.slow
def test_simulated_people_differ_and_can_be_dressed(tmp_path: Path) -> None:
    people = load_people(write_people(tmp_path, 2))
    simulated = load_people(write_simulated(people, 5, tmp_path / "more"))
    assert len(simulated) == 5 and not simulated.left_out
    assert len({person.identity for person in simulated}) == len({person.pixels for person in simulated}) == 5
    for person in simulated:
        x0, y0, x1, y1 = (round(side) for side in person.box)
        assert person.mask[y0:y1, x0:x1].sum() == person.mask.sum() > 0
        seen = person.landmarks.xy[person.landmarks.visibility > 0.5].round().astype(int)
        height, width = person.shape
        inside = person.mask[seen[:, 1].clip(0, height - 1), seen[:, 0].clip(0, width - 1)]
        assert np.mean(inside) > 0.7


@pytest.mark.long
def test_more_detectors_take_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "STEPS", 3)
    assert grow_step(4)["floor_ms"] > 1.5 * grow_step(1)["floor_ms"]


@pytest.mark.slow
def test_a_point_of_people_says_what_each_stage_took(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "BATCH", 2)
    monkeypatch.setattr(growth, "STEPS", 1)
    monkeypatch.setattr(growth, "SIZE", 128)
    monkeypatch.setenv("CLOAK_CACHE", "off")  # set anew within, for the point's own files
    figures = grow_people(2, str(write_people(tmp_path, 1)), None)
    assert figures["seconds"] == pytest.approx(figures["read_s"] + figures["fit_s"])
    assert figures["step_ms"] > figures["floor_ms"] > 0 and 10 < figures["disk_kB"] < 400


def test_series_join_those_measured_before(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made = lambda quantity, size, *_: {"size": size, "seconds": size, "working_mib": 2 * size, "peak_mib": 3 * size}
    monkeypatch.setattr(growth, "measure", made)
    for name in ("views", "pixels"):
        result = growth.run_bench_growth(threads=1, only=(name,), out=tmp_path)
    assert json.loads((tmp_path / "growth.json").read_text()) == result
    assert result["exponents"] == pytest.approx({"views": 1.0, "pixels": 0.5})


def test_bad_input() -> None:
    with pytest.raises(InputError, match="'moons'"):
        growth.run_bench_growth(only=("moons",))
    with pytest.raises(InputError, match="0 bytes"):
        growth.run_bench_growth(memory=0)
    with pytest.raises(InputError, match="needs --people"):
        growth.run_bench_growth(only=("people",))
    with pytest.raises(InputError, match="--most 30 leaves fewer than two sizes of people"):
        growth.run_bench_growth(only=("people",), people=("people.json", None), most=30)
