"""What long commands tell a program about how far they are."""

from dataclasses import replace
from pathlib import Path

import pytest

from cloak_core.cli import load
from cloak_core.commands.progress import TrainingProgress, WorkProgress, counted
from cloak_core.commands.train import Train
from cloak_core.commands.transfer import Transfer
from cloak_core.core.events import read_events
from cloak_core.core.settings import make_settings
from cloak_core.files.errors import InputError
from cloak_core.studies.pace import in_turn


def test_a_count_is_told_as_a_runs_events_are(tmp_path):
    path = tmp_path / "events.jsonl"
    with counted("counting", path) as tell:
        tell(0, 9)
        tell(4, 9)
        assert [event["type"] for event in read_events(path)] == ["start", "step"]  # while it is being done
        tell(9, 9)
        tell(1, 5)  # another part of the work
    events = read_events(path)
    told = [(event["type"], event.get("steps"), event["step"]) for event in events]
    assert told == [("start", 9, 0), ("step", None, 4), ("step", None, 9), ("start", 5, 0), ("step", None, 1)]
    times = [event["time"] for event in events]
    assert times == sorted(times) and times[0] >= 0
    with pytest.raises(InputError, match="exists already"), counted("counting", path):
        pass


def test_without_a_file_or_a_terminal_one_line_says_what_there_is_to_do(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with counted("counting") as tell:
        tell(1, 2)
    said = capsys.readouterr()
    assert not said.out and said.err.strip() == "counting: 2 images" and not list(tmp_path.iterdir())


def test_a_log_hears_at_the_start_what_there_is_to_do_and_soon_how_long_it_takes(monkeypatch, capsys):
    clock = iter(range(0, 10_000))
    monkeypatch.setattr("cloak_core.commands.progress.time.monotonic", lambda: float(next(clock)))
    with counted("counting", unit="beans") as tell:
        for done in range(0, 9):
            tell(done, 1000)
    first, second, *_ = capsys.readouterr().err.splitlines()
    assert first == "counting: 1,000 beans"
    assert second.startswith("counting: 2 of 1000; ") and second.endswith(" min left")


def test_training_says_its_pace_and_whose_success_it_is(monkeypatch, capsys):
    clock = iter(range(0, 10_000, 2))
    monkeypatch.setattr("cloak_core.commands.progress.time.monotonic", lambda: float(next(clock)))
    with TrainingProgress() as progress:
        progress({"type": "start", "step": 0, "steps": 1000})
        for step in (1, 2, 1000):
            progress({"type": "step", "step": step, "loss": 1.0, "success": 0.5, "time": 1.0 * step})
    start, first, second, last = capsys.readouterr().err.strip().splitlines()
    assert start == "training: 1,000 updates" and "left" not in first and "left" not in last
    assert "success on its last images 50%" in second and second.endswith("left")


def test_a_list_of_work_is_counted_with_the_time_left(monkeypatch):
    clock = iter(range(0, 10_000, 60))
    monkeypatch.setattr("cloak_core.studies.pace.time.monotonic", lambda: float(next(clock)))
    said: list[str] = []
    assert list(in_turn(["a", "b", "c"], str.upper, said.append)) == ["a", "b", "c"]
    assert said == ["1 of 3: A", "2 of 3: B; about 4 min 0 s left", "3 of 3: C; about 1 min 30 s left"]


def test_the_time_left_counts_how_long_each_takes(monkeypatch):
    clock = iter([0.0, 0.0, 20.0, 60.0])
    monkeypatch.setattr("cloak_core.studies.pace.time.monotonic", lambda: next(clock))
    said: list[str] = []
    assert list(in_turn([1, 2, 7], str, said.append, weight=float)) == [1, 2, 7]
    assert said == ["1 of 3: 1", "2 of 3: 2; about 3 min 0 s left", "3 of 3: 7; about 2 min 20 s left"]


@pytest.mark.parametrize(
    ("trained_on", "others"),
    [
        ("people.json[0::2]", "people.json[1::2]"),
        ("people.json[1::2]", "people.json[0::2]"),
        ("people.json[:40]", "people.json[40:]"),
        ("people.json[40:]", "people.json[:40]"),
        ("people.json", "OTHERS.json"),
        ("people.json[3]", "OTHERS.json"),
        ("people.json[0:]", "OTHERS.json"),
        ("people.json[2::3]", "OTHERS.json"),
    ],
)
def test_who_trained_on_people_is_told_to_judge_on_others(trained_on, others):
    command = Train.of(make_settings("photographs"), logo=Path("logo.npy"), out=Path("run"), people=trained_on)
    assert command.following({"out": "run"}) == ("evaluate", "run", "--people", others)
    assert ("not trained on" in command.next_why) == (others == "OTHERS.json")


def test_who_filled_a_matrix_on_people_is_told_to_train_on_people():
    command = Transfer(detector=("builtin",), out=Path("matrix"), people="people.json", images=Path("photos"))
    said = " ".join(command.following({}))
    assert "--preset photographs --people people.json --images photos --logo shirt+trousers" in said
    assert replace(command, people=None).following({})[:5] == (
        "train",
        "--preset",
        "transfer",
        "--logo",
        "chest+thighs",
    )


def test_the_first_images_say_nothing_of_the_time_left(monkeypatch, capsys):
    clock = iter(range(0, 10_000, 60))
    monkeypatch.setattr("cloak_core.commands.progress.time.monotonic", lambda: float(next(clock)))
    progress = WorkProgress()
    for done in (0, 1, 100):
        progress("zoo", done, 1000)
    assert capsys.readouterr().err.splitlines() == ["zoo: 0%", "zoo: 0%", "zoo: 10%, about 18 min left"]


LONG = ("train", "evaluate", "wear", "assess", "harden", "sweep", "transfer", "reproduce", "film", "demo")
BENCHES = ("views", "step", "detectors", "accuracy", "growth", "gpu", "stability")


@pytest.mark.parametrize("name", [*LONG, *(f"bench {name}" for name in BENCHES)])
def test_long_commands_end_with_the_next_one(name):
    assert "following" in vars(load(name)), f"cloak {name} says nothing of what comes next"
