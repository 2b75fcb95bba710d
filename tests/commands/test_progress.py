"""What long commands tell a program about how far they are."""

import pytest

from cloak_core.commands.progress import counted
from cloak_core.core.events import read_events
from cloak_core.files.errors import InputError


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


def test_without_a_file_or_a_terminal_nothing_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with counted("counting") as tell:
        tell(1, 2)
    said = capsys.readouterr()
    assert not said.out and not said.err.strip() and not list(tmp_path.iterdir())
