import pandas as pd
import pytest
import torch

from cloak_core.bench.step import run_bench_step, write_table
from cloak_core.core.settings import make_settings
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.photographs.crowd import Crowd
from cloak_core.sources.photographs.people import load_people
from tests.core.fakes import TinyDetector, box_bodies, front_logo, noise_backgrounds, tiny_settings
from tests.sources.photographs.made_people import write_people


def measure(**changes):
    bodies = box_bodies()
    return run_bench_step(
        bodies,
        [TinyDetector(0), TinyDetector(1)],
        noise_backgrounds(),
        logo_faces=front_logo(bodies).face_ids,
        settings=tiny_settings(**changes),
        threads=1,
        repeats=3,
    )


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, {"distance": "1.8:3"}])
def test_the_record_holds_together(changes, tmp_path):
    before = torch.get_num_threads()
    result = measure(**changes)
    assert torch.get_num_threads() == before
    write_table(result, tmp_path / "step.csv")
    assert pd.read_csv(tmp_path / "step.csv")["step_ms"].tolist() == [result[f"tiny:{k}"]["step_ms"] for k in (0, 1)]
    for spec in ("tiny:0", "tiny:1"):
        row = result[spec]
        assert row["batch"] == 3 and row["floor_ms"] > 0
        assert row["ratio"] == pytest.approx(row["step_ms"] / row["floor_ms"], rel=0.01)
        assert row["overhead_ms_per_image"] == pytest.approx((row["step_ms"] - row["floor_ms"]) / 3, abs=0.01)


@pytest.mark.slow
def test_people_in_photographs_are_fresh_views_with_a_cloth(tmp_path):
    people = Crowd(load_people(write_people(tmp_path, 1)))
    settings = make_settings("photographs", batch=2, size=64, translation=5)
    bodies = load_scene("sample[0:1]")
    one = run_bench_step(
        bodies, [TinyDetector(0)], noise_backgrounds(), settings=settings, people=people, threads=1, repeats=2
    )["tiny:0"]
    assert one["views"] == "fresh" and one["batch"] == 2 and one["colors"] == 100 * 100
    assert one["step_ms"] > one["floor_ms"]
