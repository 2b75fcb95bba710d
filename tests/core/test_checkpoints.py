import contextlib
import json
import os
import pickle
import time

import pytest
import torch

from cloak_core.core.checkpoints import Checkpoint, load_checkpoint, remove_unfinished, save_checkpoint
from tests.core import children


def checkpoint(step: int) -> Checkpoint:
    tensors = {"parameter": torch.full((5, 3), float(step)), "optimizer.step": torch.tensor(float(step))}
    return Checkpoint(step, step / 2, tensors)


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "checkpoint"
    folder.mkdir()
    for step in (1, 2, 30):
        save_checkpoint(folder, checkpoint(step))
    return folder


def _truncate(path):
    data = (path / "state.safetensors").read_bytes()
    (path / "state.safetensors").write_bytes(data[: len(data) // 2])


def _flip(path):
    data = bytearray((path / "state.safetensors").read_bytes())
    data[-1] ^= 1
    (path / "state.safetensors").write_bytes(bytes(data))


def _record(**changes):
    def damage(path):
        record = json.loads((path / "state.json").read_text())
        (path / "state.json").write_text(json.dumps(record | changes))

    return damage


def _pickled(path):
    import hashlib

    data = pickle.dumps({"parameter": os.getcwd})
    (path / "state.safetensors").write_bytes(data)
    _record(sha256=hashlib.sha256(data).hexdigest())(path)


@pytest.mark.parametrize(
    "damage",
    [
        _truncate,
        _flip,
        _pickled,
        _record(format="other"),
        _record(version=99),
        _record(version=None),
        _record(step=31),
        _record(step="30"),
        _record(time=None),
        lambda path: (path / "state.json").write_text("{"),
        lambda path: (path / "state.json").unlink(),
        lambda path: (path / "state.safetensors").unlink(),
    ],
)
def test_a_damaged_one_is_named_and_its_predecessor_taken(folder, damage):
    damage(folder / "step-00000030")
    found, damaged = load_checkpoint(folder)
    assert found.step == 2
    assert len(damaged) == 1 and "step-00000030" in damaged[0] and "\n" not in damaged[0]


@pytest.mark.slow
def test_killed_while_writing_there_is_always_a_whole_one(tmp_path):
    """SIGKILL at moments spread over the write: what is found is whole and at most one behind what was announced."""
    for attempt in range(8):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        process, pipe = children.start(children.write_checkpoints, str(folder))
        announced = [pipe.recv() for _ in range(3)]
        time.sleep(0.0031 * attempt)
        process.kill()
        with contextlib.suppress(EOFError):
            while True:
                announced.append(pipe.recv())
        process.join()
        found, damaged = load_checkpoint(folder)
        assert damaged == []
        assert found.step >= announced[-1]
        assert (found.tensors["parameter"] == found.step).all()
        remove_unfinished(folder)
        assert all(p.name.startswith("step-") for p in folder.iterdir())
