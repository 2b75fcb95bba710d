"""When the next batch is built: beside the detector, or between two steps."""

import threading

import numpy as np
import pytest

from cloak_core.core import batches
from cloak_core.core.batches import Batcher
from tests.core.test_training import run


@pytest.mark.slow
def test_when_a_batch_is_built_changes_no_bit(tmp_path, monkeypatch):
    scheme = {"steps": 8, "angles": "0..360", "distance": "2:2.5", "cutout": 0.3}
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
