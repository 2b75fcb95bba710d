"""A run judged on photographs: contract C6's object, and whether training saw them."""

import json

import pytest

from cloak_core.library import evaluate, train
from cloak_core.sources.photographs.people import load_people
from tests.core.fakes import RedDetector
from tests.sources.photographs.made_people import write_people

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_run_on_photographs_is_trained_and_judged(tmp_path):
    path = write_people(tmp_path / "people", 4)
    given = {"steps": 2, "batch": 2, "size": 64, "translation": 5}
    train(None, "shirt", [RedDetector()], "procedural:train:4", out=tmp_path / "run", people=f"{path}[0::2]", **given)
    judge = {"red": RedDetector()}
    unseen = evaluate(tmp_path / "run", people=f"{path}[1::2]", detectors=judge, size=128, bare=2)
    assert set(unseen["detectors"]["red"]) == {"logo", "clothing", "grey", "random", "resampled"}
    assert unseen["people"] == 2 and unseen["unseen"] == {"photographs": True}
    written = json.loads((tmp_path / "run" / "evaluation-people" / "wear.json").read_text("utf-8"))
    assert written["unseen"] == {"photographs": True} and written["white_box"] == unseen["white_box"]
    seen = evaluate(tmp_path / "run", people=load_people(path), detectors=judge, out=tmp_path / "all", size=128, bare=2)
    assert seen["unseen"] == {"photographs": False} and seen["people"] == 4
