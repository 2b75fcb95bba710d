"""Where to compute: every command takes it, the command alone changes the process; and what a demo is judged on."""

import json

import pytest
import torch

from cloak_core.cli import parse
from cloak_core.commands.options import chosen_device, prepare_process
from cloak_core.core.settings.components import ComputeSettings
from cloak_core.files.errors import InputError
from cloak_core.studies.trained_run import kept_back


@pytest.fixture
def threads():
    """The process's own, put back afterwards."""
    before = torch.get_num_threads()
    yield before
    torch.set_num_threads(before)


def test_a_command_prepares_its_process(threads):
    prepare_process(ComputeSettings(threads=threads + 1))
    assert torch.get_num_threads() == threads + 1
    prepare_process(ComputeSettings())
    assert torch.get_num_threads() == threads + 1
    with pytest.raises(InputError, match="--threads: 0 is not in"):
        prepare_process(ComputeSettings(threads=0))


def test_what_was_kept_back_is_known_either_way():
    directly = {"scene": "sample:train", "backgrounds": "procedural:train:64"}
    through_blender = directly | {"scene": "/runs/demo.input/scene", "made_from": "sample:train"}
    for inputs in (directly, through_blender):
        assert kept_back("scene", {"inputs": inputs}) == "sample:unseen"
        assert kept_back("backgrounds", {"inputs": inputs}) == "procedural:test:64"
    for name in ("sample-clothed", "sample-tight"):
        assert kept_back("scene", {"inputs": {"scene": f"{name}:train[walking*]"}}) == f"{name}:unseen"
    with pytest.raises(InputError, match="trained on people in photographs: name others, --people FILE"):
        kept_back("scene", {"inputs": {"people": "people.json"}})
    with pytest.raises(InputError, match="--scene: say what to evaluate on"):
        kept_back("scene", {"inputs": {"scene": "/runs/demo.input/scene"}})


class FakeCuda:
    """A torch.cuda that is there, or not, and works, or not."""

    def __init__(self, monkeypatch, there, works):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: there)
        monkeypatch.setattr(torch.cuda, "get_device_name", lambda device=None: "NVIDIA Fake")
        zeros = torch.zeros

        def made(*size, device=None, **options):
            if device == "cuda" and not works:
                raise RuntimeError("CUDA error: no kernel image is available")
            return zeros(*size, **options)

        monkeypatch.setattr(torch, "zeros", made)


@pytest.mark.parametrize(
    ("there", "works", "chosen", "words"),
    [
        (False, False, "cpu", ""),
        (True, False, "cpu", "CUDA is there and does not work (CUDA error: no kernel image is available)"),
        (True, True, "cuda", "computing on NVIDIA Fake"),
    ],
)
def test_auto_is_cuda_where_it_works(there, works, chosen, words, monkeypatch, capsys):
    FakeCuda(monkeypatch, there, works)
    assert chosen_device("auto") == chosen
    said = capsys.readouterr().err
    assert words in said and bool(said) == bool(words)
    assert chosen_device("cuda:1") == "cuda:1"


def test_auto_is_the_default_and_a_run_goes_on_where_it_began(tmp_path, monkeypatch):
    FakeCuda(monkeypatch, True, True)
    asked = []
    monkeypatch.setattr("cloak_core.commands.options.prepare_process", lambda compute: asked.append(compute.device))
    monkeypatch.setattr("cloak_core.library.training.train", lambda *given, **more: pytest.fail("far enough"))
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.json").write_text(json.dumps({"environment": {"device": "cpu"}}))
    words = ["--logo", "chest", "--detector", "nobodys:thing", "--out"]
    for more in ([str(tmp_path / "new")], [str(tmp_path / "run"), "--resume"]):
        with pytest.raises(InputError, match="unknown family"):
            parse("train", [*words, *more]).run()
    assert asked == ["cuda", "cpu"]
