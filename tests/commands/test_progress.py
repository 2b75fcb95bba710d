"""What long commands tell people and programs about how far they are."""

from pathlib import Path

import pytest

from cloak_core.commands.progress import WorkProgress, counted
from cloak_core.commands.train import Train
from cloak_core.core.events import read_events
from cloak_core.core.settings import make_settings
from cloak_core.files.errors import InputError


@pytest.fixture
def clock(monkeypatch):
    """The time that commands are told, in seconds; a test moves it on."""
    now = [0.0]
    monkeypatch.setattr("cloak_core.commands.progress.time.monotonic", lambda: now[0])
    return now


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


def test_parts_of_work_are_told_in_turn(clock, capsys):
    progress = WorkProgress()
    for done in (0, 1, 100):
        progress("zoo", done, 1000)
        clock[0] += 60
    assert capsys.readouterr().err.splitlines() == ["zoo: 0%", "zoo: 0%", "zoo: 10%, about 9 min left"]


@pytest.mark.parametrize(
    ("trained_on", "others"),
    [
        ("people.json[0::2]", "people.json[1::2]"),
        ("people.json[1::2]", "people.json[0::2]"),
        ("people.json[:40]", "OTHERS.json"),
        ("people.json", "OTHERS.json"),
        ("people.json[2::3]", "OTHERS.json"),
    ],
)
def test_who_trained_on_people_is_told_to_judge_on_others(trained_on, others):
    command = Train.of(make_settings("photographs"), logo=Path("logo.npy"), out=Path("run"), people=trained_on)
    assert command.following({"out": "run"}) == ("evaluate", "run", "--people", others)
    assert ("not trained on" in command.next_why) == (others == "OTHERS.json")
