"""Work that falls into parts: each part alone makes what the whole then only gathers."""

import json

import pytest

from cloak_core.commands import sharing
from cloak_core.commands.assess import Assess
from cloak_core.commands.reproduce import PARTS, Reproduce
from cloak_core.experiments.options import Options
from cloak_core.files.errors import InputError, Stopped
from cloak_core.files.writing import lock
from cloak_core.jobs.job import done
from cloak_core.studies import store, training_store
from tests.schemas import validate
from tests.sources.photographs.made_people import write_people

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
def test_parts_of_a_matrix_are_found_again_by_the_whole(transfer, elsewhere, tmp_path, monkeypatch, cloak):
    here = cloak(*transfer, "--out", tmp_path / "here")[1]
    asked = [*transfer, "--rungs", "recipe", "--out", tmp_path / "there", "--ray", "local"]
    code, there, said = cloak(*asked)
    assert code == 0 and len(elsewhere.names) == 2 and "part 1 of 2: recipe, judged by" in said
    matrix = validate("transfer", there)["matrix"]
    rates = lambda cells: {spec: cell["success"] for spec, cell in cells.items()}
    assert rates(matrix) == rates(json.loads(here)["matrix"])
    # What the parts made is there: nothing is trained or measured any more.
    for module, name in ((training_store, "train"), (store, "measure_frozen")):
        monkeypatch.setattr(module, name, lambda *given, **more: pytest.fail("made again"))
    assert cloak(*asked)[0] == 0


def test_people_are_fitted_on_a_cluster_where_one_is_named(tmp_path, monkeypatch, cloak):
    """tests/jobs/test_ray.py has a real cluster, and kills a node of it."""
    asked = []
    monkeypatch.setattr("cloak_core.commands.wear.executor_of", lambda address: asked.append(address))
    _, said, _ = cloak("people", "fit", write_people(tmp_path, 1), "--ray", "auto")
    assert asked == ["auto"] and "1 people in 1 photographs; left out: nobody" in said


def failing(error):
    """A training that ends so."""

    def train(self, *given, **more):
        raise error

    return train


def test_a_part_that_fails_is_named_after_the_others_are_done(transfer, elsewhere, tmp_path, monkeypatch, cloak):
    monkeypatch.setattr(store.RunStore, "train_faces", failing(InputError("no")))
    code, _, said = cloak(*transfer, "--out", tmp_path / "out", "--ray", "local")
    assert code == 2 and "2 of 2 parts failed, the first of them recipe, judged by" in said
    assert said.rstrip().endswith(": no")


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
def test_a_real_cluster_makes_the_matrix_of_one_process(transfer, tmp_path, tmp_path_factory, cloak):
    pytest.importorskip("ray")
    with lock(tmp_path_factory.getbasetemp().parent / "ray.lock", wait=True):  # one cluster at a time on this machine
        code, there, said = cloak(*transfer, "--out", tmp_path / "there", "--ray", "local", "--threads", 1)
    assert code == 0 and "part 2 of 2" in said
    here = cloak(*transfer, "--out", tmp_path / "here", "--threads", 1)[1]
    ours, theirs = (json.loads(text)["matrix"] for text in (here, there))
    for cells in (ours, theirs):
        for cell in cells.values():
            cell.pop("seconds")
    assert ours == theirs


def test_a_part_that_was_ended_early_ends_the_command_in_order(transfer, elsewhere, tmp_path, monkeypatch, cloak):
    monkeypatch.setattr(store.RunStore, "train_faces", failing(Stopped("enough")))
    assert cloak(*transfer, "--out", tmp_path / "out", "--ray", "local")[0] == 3
    assert len(elsewhere.names) == 1
