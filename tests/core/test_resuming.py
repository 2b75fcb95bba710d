"""Runs are stopped in order; those stopped, damaged or finished go on, to the same bits, or are refused by name."""

import contextlib
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cloak_core.core import loop
from cloak_core.core.events import read_events
from cloak_core.core.loop import stop_request
from cloak_core.exchange.face_lists import read_colors
from cloak_core.files.errors import InputError
from tests.core.fakes import TinyDetector
from tests.core.test_training import run


@pytest.mark.slow
@pytest.mark.parametrize("how", ["file", "budget", "signal"])
def test_stopped_runs_go_on_to_the_same_bits(tmp_path, how):
    whole = run(tmp_path / "whole", steps=7)

    def stop(event):
        if event["type"] == "step" and event["step"] == 3:
            if how == "file":
                (tmp_path / "run" / "cancel").touch()
            elif how == "signal":
                os.kill(os.getpid(), signal.SIGTERM)

    changes = {"max_seconds": 1e-6} if how == "budget" else {}
    part = run(tmp_path / "run", steps=7, on_event=stop, **changes)
    assert part.step == (1 if how == "budget" else 3)
    assert part.stopped == {"file": "cancel file", "budget": "time budget", "signal": "SIGTERM"}[how]
    assert part.record()["stopped"].startswith("stopped at step")
    assert np.array_equal(read_colors(tmp_path / "run" / "colors.npy"), part.colors)
    rest = run(tmp_path / "run", steps=7, resume=True)
    assert (rest.step, rest.stopped) == (7, "")
    assert np.array_equal(rest.colors, whole.colors)
    events = [e for e in read_events(tmp_path / "run" / "events.jsonl") if e["type"] == "step"]
    assert [e["step"] for e in events] == [1, 2, 3, 4, 5, 6, 7]
    assert [e["time"] for e in events] == sorted(e["time"] for e in events)
    drop_time = lambda es: [{k: v for k, v in e.items() if k != "time"} for e in es if e["type"] == "step"]
    assert drop_time(events) == drop_time(read_events(tmp_path / "whole" / "events.jsonl"))


@pytest.mark.slow
def test_resuming_a_finished_run_changes_nothing(tmp_path):
    done = run(tmp_path / "run")
    names = (".cost.json.1yv8pe0c", ".cloth.png.a_bc1234", "previews/.step-00000001.png.12345678")
    left, mine = [tmp_path / "run" / name for name in names], tmp_path / "run" / ".mine"
    for path in [*left, mine]:
        path.touch()
    again = run(tmp_path / "run", resume=True)
    assert np.array_equal(done.colors, again.colors) and again.stopped == ""
    assert mine.exists() and not [path for path in left if path.exists()], "what killed writers left goes"
    assert again.figures == done.figures and again.record()["loss"] == done.record()["loss"]


@pytest.mark.slow
def test_a_damaged_checkpoint_costs_its_steps_only(tmp_path):
    whole = run(tmp_path / "whole", steps=7)
    run(tmp_path / "run", steps=7)
    for latest in sorted((tmp_path / "run" / "checkpoint").iterdir())[1:]:
        (latest / "state.safetensors").write_bytes(b"torn")
    heard = []
    rest = run(tmp_path / "run", steps=7, resume=True, on_event=heard.append)
    assert heard[0]["type"] == "resume" and heard[0]["step"] == 6 and "torn or changed" in heard[0]["damaged"][0]
    assert np.array_equal(rest.colors, whole.colors)


@pytest.mark.slow
def test_resuming_with_anything_else_is_refused_by_name(tmp_path):
    run(tmp_path / "run")
    with pytest.raises(InputError, match=r"settings\.seed = 0, not 1"):
        run(tmp_path / "run", resume=True, seed=1)
    with pytest.raises(InputError, match="detectors"):
        run(tmp_path / "run", [TinyDetector(1)], resume=True)
    detector = TinyDetector()
    detector.operating_point = 0.1
    with pytest.raises(InputError, match=r"operating_point = 0\.5, not 0\.1"):
        run(tmp_path / "run", [detector], resume=True)
    run(tmp_path / "run", resume=True, checkpoint_every=5)


def test_a_run_that_appears_meanwhile_is_gone_on_with(tmp_path, monkeypatch):
    """Another process makes the folder between our look and our start: resuming goes on, a new run is refused."""
    make = loop.new_folder

    @contextlib.contextmanager
    def after_another(path: Path) -> Iterator[Path]:
        with make(path) as ours:
            yield ours
            shutil.copytree(ours, path)

    monkeypatch.setattr(loop, "new_folder", after_another)
    with pytest.raises(InputError, match="first"):
        run(tmp_path / "first", steps=2)
    run(tmp_path / "second", steps=2, resume=True)
    assert (tmp_path / "second" / "colors.npy").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_asks_once_and_then_acts(tmp_path, number):
    heard = []
    before = signal.signal(number, lambda *_: heard.append("ours"))
    try:
        with stop_request(tmp_path / "cancel") as stop:
            assert stop.reason(0.0) == ""
            os.kill(os.getpid(), number)
            assert stop.reason(0.0) == signal.Signals(number).name
            assert heard == []
            os.kill(os.getpid(), number)
            assert heard == ["ours"]
        os.kill(os.getpid(), number)
        assert heard == ["ours", "ours"]
    finally:
        signal.signal(number, before)
