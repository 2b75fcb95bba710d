"""Growth in training: people who are simulated, and the points of its series."""

from pathlib import Path

import numpy as np
import pytest

from cloak_core.bench import growth_training
from cloak_core.bench.growth import run_bench_growth
from cloak_core.bench.growth_training import grow_people, grow_step
from cloak_core.bench.simulated_people import write_simulated
from cloak_core.files.errors import InputError
from cloak_core.sources.photographs.people import load_people
from tests.sources.photographs.made_people import write_people

pytestmark = pytest.mark.slow


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


def test_a_point_of_people_says_what_each_stage_took(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth_training, "BATCH", 2)
    monkeypatch.setattr(growth_training, "STEPS", 1)
    monkeypatch.setattr(growth_training, "SIZE", 128)
    monkeypatch.setenv("CLOAK_CACHE", "off")  # set anew within, for the point's own files
    figures = grow_people(2, str(write_people(tmp_path, 1)), None)
    assert figures["seconds"] == pytest.approx(figures["read_s"] + figures["fit_s"])
    assert figures["step_ms"] > figures["floor_ms"] > 0 and 10 < figures["disk_kB"] < 400


@pytest.mark.long
def test_more_detectors_take_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth_training, "STEPS", 3)
    assert grow_step(4, None)["floor_ms"] > 1.5 * grow_step(1, None)["floor_ms"]


def test_bad_input() -> None:
    with pytest.raises(InputError, match="needs --people"):
        run_bench_growth(only=("people",))
    with pytest.raises(InputError, match="--most 30 leaves fewer than two sizes of people"):
        run_bench_growth(only=("people",), people=("people.json", None), most=30)
