import pytest
import torch

from cloak_core.bench.step import run_bench_step, step_table
from cloak_core.files.errors import InputError
from tests.core.fakes import TinyDetector, box_bodies, front_logo, noise_backgrounds, tiny_settings


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
def test_the_record_holds_together(changes):
    before = torch.get_num_threads()
    result = measure(**changes)
    assert torch.get_num_threads() == before
    assert step_table(result).count("| tiny |") == 2
    for spec in ("tiny:0", "tiny:1"):
        row = result[spec]
        assert row["batch"] == 3 and row["floor_ms"] > 0
        assert row["ratio"] == pytest.approx(row["step_ms"] / row["floor_ms"], rel=0.01)
        assert row["overhead_ms_per_image"] == pytest.approx((row["step_ms"] - row["floor_ms"]) / 3, abs=0.01)


@pytest.mark.slow
def test_a_fresh_view_for_every_image_costs_more():
    cached, fresh = measure()["tiny:0"], measure(angle_jitter=5)["tiny:0"]
    assert fresh["parts_ms"]["next_batch"] > 1.5 * cached["parts_ms"]["next_batch"]


def test_bad_input():
    with pytest.raises(InputError, match="repeats"):
        run_bench_step(box_bodies(), [TinyDetector()], noise_backgrounds(), repeats=0)
