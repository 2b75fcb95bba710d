"""Jobs outside Blender, and what a training's events tell of it."""

import json
import re
import sys
from operator import attrgetter
from pathlib import Path

import pytest
from cloak.files.errors import InputError
from cloak.session import session
from cloak.trainer import jobs
from cloak.trainer.jobs import Job, TrainingJob
from cloak.trainer.progress import Progress, take_event
from cloak.training import runs
from cloak.ui import window
from conftest import run_job


@pytest.mark.parametrize(
    "line",
    [b"", b"{", b"[]", b"3", b"null", b'{"step": 4}', b'{"type": 3}', b"\xff\xfe", b"[" * 100_000, b'{"type": "step"}'],
)
def test_no_line_can_upset_the_progress(line):
    before = Progress(step=3, steps=9, loss=0.5)
    after = take_event(before, line)
    assert (after.step, after.steps, after.loss) == (3, 9, 0.5)


def test_time_left_follows_the_pace():
    progress = take_event(Progress(), b'{"type": "start", "step": 0, "time": 0, "steps": 100}')
    for step in range(1, 11):
        progress = take_event(progress, json.dumps({"type": "step", "step": step, "time": 2.0 * step}).encode())
    assert progress.seconds_left == pytest.approx(180)
    assert "3 min left" in progress.describe()


def test_a_job_runs_its_commands_in_order_and_stops_at_the_first_that_fails(tmp_path):
    def say(text: str) -> list[str]:
        return [sys.executable, "-c", f"print({text!r})"]

    ended = []
    job = Job("Two", [say("one"), say("two")], tmp_path, "two", ended.append).wait()
    assert job.outputs == ["one\n", "two\n"] and ended == [job] and job.fraction == 1 and job.message == "Two done"
    job = Job("Bad", [[sys.executable, "-c", "import sys; sys.exit('boom')"], say("no")], tmp_path, "bad").wait()
    assert (job.state, job.outputs) == ("failed", [""]) and "boom" in job.message
    with pytest.raises(InputError, match="cannot be started"):
        Job("None", [["/nowhere/python"]], tmp_path, "none").start()
    job = Job("Long", [[sys.executable, "-c", "import time; time.sleep(60)"]], tmp_path, "long").start()
    job.cancel()
    assert job.wait(120).state == "stopped"


def test_what_follows_a_job_may_fail_it_or_have_the_last_word(tmp_path, stub):
    def refuse(job: Job) -> None:
        raise InputError("the object is gone")

    job = Job("One", [[str(stub), "-c", "pass"]], tmp_path, "one", refuse).wait()
    assert (job.state, job.message) == ("failed", "the object is gone")
    job = Job("One", [[str(stub), "-c", "pass"]], tmp_path, "one", lambda job: "Opened it").wait()
    assert (job.state, job.message) == ("done", "Opened it")


def test_jobs_wait_their_turn_and_say_so(tmp_path, stub):
    quick = [[str(stub), "-c", "pass"]]
    first = jobs.launch(Job("One", [[str(stub), "-c", "import time; time.sleep(0.5)"]], tmp_path, "one"))
    second, third, lost = (jobs.launch(Job(name, quick, tmp_path, name)) for name in ("Two", "Three", "Lost"))
    assert second.describe() == "Waits for One" and session.job is first
    assert session.job_of("Three") is third and second.state == third.state == "waiting"
    third.cancel()
    lost._commands = [["/nowhere/python"]]
    run_job()
    assert [job.state for job in (first, second, third, lost)] == ["done", "done", "stopped", "failed"]
    assert third.message == "Three stopped" and "cannot be started" in lost.message


def test_no_timer_acts_while_a_tool_is_at_work(tmp_path, stub, monkeypatch):
    """Each that is registered anywhere waits; what a job's end does comes when the tool has ended."""
    timers = []
    for name, module in [
        (n, m) for n, m in sys.modules.items() if n.startswith("cloak.") and getattr(m, "__file__", 0)
    ]:
        for timer in re.findall(r"timers\.register\(([\w.]+)", Path(module.__file__).read_text()):
            timers.append(f"{name}.{timer}")
            assert hasattr(attrgetter(timer)(module), "__wrapped__"), timers[-1]
    assert len(timers) >= 5
    ended = []
    job = jobs.launch(Job("One", [[str(stub), "-c", "pass"]], tmp_path, "one", ended.append))
    job._process.wait()
    monkeypatch.setattr(window, "tool_at_work", lambda: "Sculpt")
    assert jobs.tick() == jobs.TICK_SECONDS and job.running and not ended
    monkeypatch.undo()
    assert run_job().state == "done" and ended == [job]


def test_run_folders_never_collide(tmp_path):
    first = runs.new_run(tmp_path, "a:b", "c*?")
    assert first.name == "a_b c_"
    runs.input_folder(first).mkdir()
    assert runs.new_run(tmp_path, "a:b", "c*?").name == "a_b c_ 2"
    assert runs.new_run(tmp_path, "..", "..").name == "run" or ".." not in runs.new_run(tmp_path, "..", "..").parts


def test_a_training_job_without_events_still_ends(tmp_path, stub):
    run = tmp_path / "never"
    job = TrainingJob([str(stub), "-c", "pass"], run, tmp_path)
    assert job.wait(120).state == "done" and job.progress == Progress()
