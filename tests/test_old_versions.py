"""What earlier versions wrote is still read: scenes, face lists, finished runs and runs to go on with."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cloak_core.core.events import read_events
from cloak_core.exchange.face_lists import read_face_list
from cloak_core.exchange.scenes import read_scene
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.studies.report.stored import check_folder, is_earlier_on_people
from cloak_core.studies.trained_run import seen_in_training
from cloak_core.zoo.adding import _photographs as zoo_photographs
from cloak_core.zoo.entry import run_path
from tests.core.test_run_identity import picture

VERSIONS = Path(__file__).parent / "old_versions"
OLD = VERSIONS / "v0.1.0"
SETTINGS = {"size": "96", "translation": "8", "batch": "2", "preview-every": "0", "seed": "3", "distance": "2.0:2.4"}
SETTINGS |= {"detector": "builtin@96", "backgrounds": "procedural:train:4", "angles": "-10:10:10"}
AS_BEFORE = [*(f"--{name}={value}" for name, value in SETTINGS.items()), "--steps=400"]


@pytest.fixture(params=["v0.1.0", "v1.0.0"])
def old(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """The files that a version wrote with the same commands, to be written to."""
    return Path(shutil.copytree(VERSIONS / request.param, tmp_path / "old"))


def told(arguments: list[str], cloak: Callable[..., tuple[int, str, str]]) -> tuple[int, dict, str]:
    """Exit code, the object that --json prints, and what stands on standard error."""
    code, out, err = cloak(*arguments, "--json")
    return code, json.loads(out or "{}"), err


def test_a_scene_and_face_lists() -> None:
    bodies = read_scene(OLD / "scene")
    config = json.loads((OLD / "done" / "config.json").read_text())
    assert bodies.topology == config["topology"] and (bodies.pose_count, bodies.face_count) == (2, 96)
    assert list(bodies.pose_hashes) == config["scene"]["pose_sha256"]
    assert len(read_face_list(OLD / "logo.npy", bodies).ids) == 16
    reference = read_face_list(OLD / "reference.idx")
    assert len(reference.ids) and not reference.topology


def train(old: Path, out: str, *more: str) -> list[str]:
    threads = json.loads((old / "stopped" / "config.json").read_text())["settings"]["threads"]
    begun = [] if threads is None else ["--threads", str(threads)]
    names = ["--scene", str(old / "scene"), "--logo", str(old / "logo.npy"), "--out", str(old / out)]
    return ["train", *names, *begun, *more]


@pytest.mark.slow
def test_a_stopped_run_goes_on_with_the_same_settings(old: Path, cloak, caplog: pytest.LogCaptureFixture) -> None:
    before = (old / "stopped" / "config.json").read_bytes()
    code, result, said = told(train(old, "stopped", *AS_BEFORE, "--resume", "--max-seconds", "2"), cloak)
    assert code == 3, said
    assert result["step"] > 1 and np.load(old / "stopped" / "colors.npy").shape == (16, 3)
    assert (old / "stopped" / "config.json").read_bytes() == before
    (resumed,) = [event for event in read_events(old / "stopped" / "events.jsonl") if event["type"] == "resume"]
    begun = json.loads(before)["cloak"]
    assert resumed["step"] == 1 and resumed["changes"][0] == f"other code (of Cloak {begun})"
    assert "began with other code" in caplog.text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "named"),
    [
        (("--tv-weight", "1"), "tv_weight = 2.5, not 1.0"),
        (("--detector", "builtin@64"), "the number of detectors = 1, not 2"),
        (("--backgrounds", "procedural:train:5"), "the number of backgrounds.identities = 4, not 5"),
    ],
)
def test_a_stopped_run_does_not_go_on_with_others(old: Path, cloak, changed: tuple[str, str], named: str) -> None:
    code, _, said = told(train(old, "stopped", *AS_BEFORE, "--resume", *changed), cloak)
    assert code == 2 and named in " ".join(said.split())


def test_colours_of_a_finished_run_start_another(old: Path, cloak) -> None:
    short = [*AS_BEFORE[:-1], "--steps=1", "--init", str(old / "done")]
    code, result, said = told(train(old, "new", *short), cloak)
    assert code == 0 and result["step"] == 1, said


@pytest.mark.slow
def test_a_finished_run_is_evaluated_and_reported(old: Path, cloak) -> None:
    assert told(["report", str(old / "done")], cloak)[0] == 0
    options = ["--angles", "0", "--images-per-view", "2", "--size", "96", "--shift", "8", "--resamples", "100"]
    arguments = ["evaluate", str(old / "done"), "--scene", str(old / "scene"), "--backgrounds", "procedural:train:4"]
    code, result, said = told([*arguments, *options], cloak)
    assert code == 0, said
    assert result["unseen"] == {"bodies": False, "backgrounds": False} and result["white_box"] == {"builtin@96": True}


def test_backgrounds_that_were_known_by_their_files_are_recognized(old: Path, tmp_path: Path) -> None:
    for i in range(2):
        picture(tmp_path / "pictures", f"{i}.png", i)
    backgrounds = load_backgrounds(tmp_path / "pictures", (32, 32))
    config = json.loads((old / "done" / "config.json").read_text())
    config["backgrounds"] = {"count": 1, "identities": [backgrounds.pictures[1].file]}
    unseen, warnings = seen_in_training(config, read_scene(old / "scene"), backgrounds)
    assert unseen == {"bodies": False, "backgrounds": False} and "(1.png)" in warnings[1]
    unseen, _ = seen_in_training(config, read_scene(old / "scene"), backgrounds.subset([0]))
    assert unseen["backgrounds"] is None, "it may be a part of one"


FIRST = VERSIONS / "v1.0.0"


@pytest.mark.parametrize("words", [["leaderboard", "build", "cards"], ["assess", "--out", "cards"]])
def test_cards_of_protocol_1_are_refused_in_one_line(words: list[str], cloak, monkeypatch) -> None:
    monkeypatch.chdir(FIRST)
    code, _, said = told(words, cloak)
    assert code == 2 and said.count("\n") == 1 and "card.json: protocol is '1'; this version has '2'" in said


@pytest.mark.slow
def test_a_sweep_of_1_0_is_read_and_not_gone_on_with(old_sweep: Path, cloak, monkeypatch) -> None:
    monkeypatch.chdir(old_sweep)
    assert (run_path("sweep") / "config.json").is_file()
    code, _, said = told(["sweep", "grid.toml", "--out", "sweep"], cloak)
    assert code == 2 and "sweep: holds the results of a sweep by an earlier version" in said


@pytest.fixture
def old_sweep(tmp_path: Path) -> Path:
    return Path(shutil.copytree(FIRST, tmp_path / "first"))


def test_an_evaluation_on_people_of_1_0_is_replaced_and_makes_no_entry_of_the_zoo() -> None:
    folder = FIRST / "body" / "evaluation-people"
    assert is_earlier_on_people(folder) and check_folder(folder) == folder
    with pytest.raises(InputError, match="evaluation-people: of an earlier version: evaluate on people again"):
        zoo_photographs(folder.parent, json.loads((folder.parent / "config.json").read_text()))


@pytest.mark.slow
def test_a_hardening_of_1_0_is_not_gone_on_with(tmp_path: Path, cloak) -> None:
    shutil.copytree(FIRST / "hardened", tmp_path / "hardened")
    code, _, said = told(["harden", "builtin", "--resume", "--no-assess", "--out", str(tmp_path / "hardened")], cloak)
    assert code == 2 and "hardened: was begun by an earlier version" in " ".join(said.split())
