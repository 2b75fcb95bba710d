"""The record of a GPU: what is said without one, and that a part which fails does not end the others."""

import json
from pathlib import Path

import pytest
import torch

from cloak_core.bench import gpu
from cloak_core.files.errors import InputError

pytestmark = pytest.mark.slow


def test_without_a_device_every_part_is_said_to_be_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    record = gpu.run_bench_gpu(out=tmp_path / "gpu.json")
    assert record["not_run"] == dict.fromkeys(gpu.PARTS, "no CUDA device") and not record["measured"]
    assert json.loads((tmp_path / "gpu.json").read_text()) == json.loads(json.dumps(record))


def test_a_part_that_fails_is_named_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(material: gpu.Material) -> dict:
        raise InputError("no room")

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(gpu, "machine", lambda device: {})
    monkeypatch.setattr(gpu, "PARTS", {"one": refuse, "other": lambda material: {"ms": 1.0}})
    record = gpu.run_bench_gpu()
    assert record["failed"] == {"one": "no room"} and record["measured"] == {"other": {"ms": 1.0}}
