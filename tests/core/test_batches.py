"""When the next batch is built: beside the detector, or between two steps."""

import threading

import numpy as np
import pytest
import torch

from cloak_core.core import batches
from cloak_core.core.batches import Batcher, looks_ahead
from cloak_core.core.held_out import TrainingData
from cloak_core.studies.trainings.training import make_batcher
from tests.core.fakes import box_bodies, front_logo, noise_backgrounds, tiny_settings
from tests.core.test_training import run

CPU = torch.device("cpu")


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr(batches, "_cores", lambda: 2)
    monkeypatch.delenv("LOCAL_WORLD_SIZE", raising=False)
    before = torch.get_num_threads()
    yield monkeypatch
    torch.set_num_threads(before)


def test_a_batch_is_built_ahead_where_a_core_is_idle(two_cores):
    torch.set_num_threads(2)
    assert not looks_ahead(CPU) and looks_ahead(torch.device("cuda"))
    torch.set_num_threads(1)
    assert looks_ahead(CPU)
    two_cores.setenv("LOCAL_WORLD_SIZE", "2")  # torchrun: two processes of one thread each
    assert not looks_ahead(CPU)


@pytest.mark.slow
def test_when_a_batch_is_built_changes_no_bit(tmp_path, monkeypatch):
    scheme = {"steps": 8, "angles": "0..360", "hard_views": 0.5, "distance": "2:2.5", "occluders": 1}
    found, threads = {}, {}
    build = Batcher.batch

    def told(self: Batcher, step: int, rank: int = 0, ranks: int = 1) -> batches.Batch:
        threads.setdefault(ahead, set()).add(threading.current_thread().name.partition("_")[0])
        return build(self, step, rank, ranks)

    monkeypatch.setattr(Batcher, "batch", told)
    for ahead in (True, False):
        monkeypatch.setattr(batches, "looks_ahead", lambda device, ahead=ahead: ahead)
        found[ahead] = run(tmp_path / str(ahead), **scheme).colors
    assert threads == {True: {"MainThread", "batches"}, False: {"MainThread"}}
    assert np.array_equal(found[True], found[False])


def test_wrinkles_give_each_pose_several_folds_and_are_off_by_default():
    bodies = box_bodies(poses=2)
    material, logo = TrainingData(bodies, noise_backgrounds()), front_logo(bodies)
    batcher = lambda **changes: make_batcher(tiny_settings(**changes), material, logo, CPU)
    assert batcher().view_cache.bodies is bodies
    folded = batcher(wrinkles=0.02, wrinkle_draws=3)
    assert folded.sampler.pose_count == folded.view_cache.bodies.pose_count == 6
    assert folded.view_cache.bodies.topology == bodies.topology
    again = batcher(wrinkles=0.02, wrinkle_draws=3, seed=1)
    assert not np.array_equal(folded.view_cache.bodies.vertices, again.view_cache.bodies.vertices)
