import pytest

from cloak_core.core.events import EventLog, read_events, rewind_events
from cloak_core.files.errors import InputError


@pytest.fixture
def path(tmp_path):
    log = EventLog(tmp_path / "events.jsonl")
    log.write({"type": "start", "step": 0, "time": 0.0})
    for step in range(1, 6):
        log.write({"type": "step", "step": step, "time": step / 10})
    log.write({"type": "end", "step": 5, "time": 0.5})
    log.close()
    return log.path


def test_a_torn_last_line_and_rubbish_are_skipped(path):
    with path.open("ab") as file:
        file.write(b'[1, 2]\n\xff\xfe\n\n{"type": "st')
    assert [e["step"] for e in read_events(path)] == [0, 1, 2, 3, 4, 5, 5]


def test_rewinding_drops_what_a_resumed_run_will_do_again(path):
    with path.open("ab") as file:
        file.write(b'{"type": "st')
    rewind_events(path, 3)
    assert [e["step"] for e in read_events(path)] == [0, 1, 2, 3]
    log = EventLog(path)
    log.write({"type": "step", "step": 4, "time": 0.4})
    log.close()
    assert read_events(path)[-1]["step"] == 4


def test_not_a_number_is_never_written(path):
    log = EventLog(path)
    with pytest.raises(ValueError):
        log.write({"type": "step", "loss": float("nan")})
    log.close()


def test_a_log_of_absurd_size_is_not_read(tmp_path):
    with (tmp_path / "events.jsonl").open("wb") as file:
        file.truncate(1 << 33)
    with pytest.raises(InputError, match="larger than any file"):
        read_events(tmp_path / "events.jsonl")
