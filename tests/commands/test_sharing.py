"""Work that falls into parts: each part alone makes what the whole then only gathers."""

import json

import pytest

from cloak_core import cli
from cloak_core.commands import sharing
from cloak_core.commands.assess import Assess
from cloak_core.commands.reproduce import PARTS, Reproduce
from cloak_core.experiments.options import Options
from cloak_core.files.errors import InputError, Stopped
from cloak_core.files.writing import lock
from cloak_core.jobs.job import done
from cloak_core.studies import store, training_store
from tests.schemas import validate

DETECTORS = """
import torch
from cloak_core.core.detector.protocol import Detections, Detector

class Glow(Detector):
    def __init__(self, channel):
        super().__init__(f"glow {channel}", f"glow {channel}")
        self.register_buffer("channel", torch.tensor(channel))
    def forward(self, images):
        scores = torch.sigmoid(8 * (images[:, int(self.channel)].mean((1, 2)) - 0.5))[:, None]
        return Detections(scores.new_zeros(len(images), 1, 4), scores)

def red(): return Glow(0)
def green(): return Glow(1)
def blue(): return Glow(2)
"""


def main(words):
    """The exit code."""
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    return end.value.code or 0


class Told:
    """Done here, but as elsewhere; remembers the jobs' names."""

    def __init__(self):
        self.names = []

    def run(self, jobs):
        for job in jobs:
            self.names.append(job.name)
            yield done(job)


@pytest.fixture
def elsewhere(monkeypatch):
    told = Told()
    monkeypatch.setattr(sharing, "executor_of", lambda address: told if address else None)
    return told


@pytest.fixture
def transfer(tmp_path):
    file = tmp_path / "glow.py"
    file.write_text(DETECTORS)
    red, green, blue = (f"python:{file}:{name}" for name in ("red", "green", "blue"))
    few = ["--scene", "sample:unseen[0:2]", "--backgrounds", "procedural:train:4", "--steps", "1", "--batch", "1"]
    few += ["--size", "64", "--images-per-view", "1", "--most-images", "2", "--json"]
    return ["transfer", "--detector", red, "--detector", green, "--judge", blue, "--judge", red, *few]


@pytest.mark.slow
def test_parts_of_a_matrix_are_found_again_by_the_whole(transfer, elsewhere, tmp_path, monkeypatch, capsys):
    assert main([*transfer, "--out", str(tmp_path / "here")]) == 0
    here = json.loads(capsys.readouterr().out)
    asked = [*transfer, "--rungs", "recipe", "--out", str(tmp_path / "there"), "--ray", "local"]
    assert main(asked) == 0
    there, said = capsys.readouterr()
    assert len(elsewhere.names) == 2 and "part 1 of 2: recipe, judged by" in said
    matrix = validate("transfer", there)["matrix"]
    assert {s: c["success"] for s, c in matrix.items()} == {s: c["success"] for s, c in here["matrix"].items()}
    # What the parts made is there: nothing is trained or measured any more.
    for module, name in ((training_store, "train"), (store, "measure_frozen")):
        monkeypatch.setattr(module, name, lambda *given, **more: pytest.fail("made again"))
    assert main(asked) == 0


def failing(error):
    """A training that ends so."""

    def train(self, *given, **more):
        raise error

    return train


def test_a_part_that_fails_is_named_after_the_others_are_done(transfer, elsewhere, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(store.RunStore, "train_faces", failing(InputError("no")))
    assert main([*transfer, "--out", str(tmp_path / "out"), "--ray", "local"]) == 2
    said = capsys.readouterr().err
    assert "2 of 2 parts failed, the first of them recipe, judged by" in said and said.rstrip().endswith(": no")


def test_cards_and_experiments_fall_into_parts(tmp_path):
    cards = Assess(specs=("builtin", "jpeg=75:builtin", "builtin"), out=tmp_path)._parts()
    assert [part.specs for _, part in cards] == [("builtin",), ("jpeg=75:builtin",)]
    parts = Reproduce(name="table1", detector=("a", "b"), amount=Options(out=tmp_path, steps=(3, 4)))._parts()
    assert [part.part for _, part in parts] == [(k, PARTS) for k in range(PARTS)]
    assert {(part.detector, part.amount.steps) for _, part in parts} == {(("a", "b"), (3, 4))}
    every = Reproduce(name="all", amount=Options(out=tmp_path))._parts()
    assert {"hardened, 3 of 8", "transfer, 8 of 8", "render-gap, 1 of 1"} <= dict(every).keys()
    assert all(part.sharing.ray is None for _, part in (*cards, *parts, *every))


@pytest.mark.long
def test_a_real_cluster_makes_the_matrix_of_one_process(transfer, tmp_path, tmp_path_factory, capsys):
    pytest.importorskip("ray")
    with lock(tmp_path_factory.getbasetemp().parent / "ray.lock", wait=True):  # one cluster at a time on this machine
        assert main([*transfer, "--out", str(tmp_path / "there"), "--ray", "local", "--threads", "1"]) == 0
    there, said = capsys.readouterr()
    assert "part 2 of 2" in said
    assert main([*transfer, "--out", str(tmp_path / "here"), "--threads", "1"]) == 0
    here = capsys.readouterr().out
    ours, theirs = (json.loads(text)["matrix"] for text in (here, there))
    for cells in (ours, theirs):
        for cell in cells.values():
            cell.pop("seconds")
    assert ours == theirs


def test_a_part_that_was_ended_early_ends_the_command_in_order(transfer, elsewhere, tmp_path, monkeypatch):
    monkeypatch.setattr(store.RunStore, "train_faces", failing(Stopped("enough")))
    assert main([*transfer, "--out", str(tmp_path / "out"), "--ray", "local"]) == 3
    assert len(elsewhere.names) == 1
