"""What the trainer is started with: a Python that has it, and settings that can work."""

import functools
import json
import math
import operator
import re
import sys
from pathlib import Path

import bpy
import cloak
import numpy as np
import pytest
from cloak.blender import colors, pictures
from cloak.files.errors import InputError
from cloak.result import judging
from cloak.session import session
from cloak.trainer import jobs, program
from cloak.trainer.jobs import Job
from cloak.trainer.program import cloak_command, preferences, trainer_reason
from cloak.trainer.progress import Progress, take_event
from cloak.training import runs
from cloak.training.operators import train_reason
from conftest import run_job
from made import make_egg, set_mode

# --- the program ------------------------------------------------------------------------------------------------------


def make_program(place: Path, text: str = "exit 0") -> Path:
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(f"#!/bin/sh\n{text}\n")
    place.chmod(0o755)
    return place


@pytest.fixture
def nowhere(monkeypatch, tmp_path) -> Path:
    """A machine without a trainer; returns the user's home."""
    for name in ("CLOAK_PROGRAM", "UV_TOOL_BIN_DIR", "PIPX_BIN_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", "/bin")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    program._reason.cache_clear()
    preferences().program = ""
    return tmp_path / "home"


@pytest.mark.parametrize(
    "place",
    [".local/bin/cloak", ".local/share/uv/tools/cloak-core/bin/cloak", ".local/pipx/venvs/cloak-core/bin/cloak"],
)
def test_the_program_is_found_where_installers_put_it_and_not_started(nowhere, place, tmp_path):
    with pytest.raises(InputError, match="No trainer found"):
        program.find_program()
    made = make_program(nowhere / place, f"touch '{tmp_path}/started'")
    assert program.find_program() == str(made) and trainer_reason() == ""
    assert cloak_command(str(made), "x") == [str(made), "x", "--json"] and not (tmp_path / "started").exists()


def test_without_a_trainer_what_needs_one_is_not_there_and_the_rest_works(ready, nowhere):
    preferences().program = ""
    assert 'uv tool install "PATH/cloak_core-' in trainer_reason()
    shown = {cls.__name__ for cls in cloak.CLASSES if issubclass(cls, bpy.types.Panel) and cls.poll(bpy.context)}
    hidden = {"train", "evaluation", "eye", "wear"}
    assert not shown & {f"CLOAK_PT_{name}" for name in hidden} and {"CLOAK_PT_logo", "CLOAK_PT_result"} <= shown
    with pytest.raises(RuntimeError, match=r"poll\(\).*No trainer found"):
        bpy.ops.cloak.train_start()
    assert not Path(bpy.context.scene.cloak.output).exists()  # nothing half-written
    bpy.ops.cloak.logo_stamp()
    bpy.ops.cloak.copy_install_line()
    bpy.ops.cloak.add_sample_body()
    sample = bpy.context.object
    assert sample.name.startswith("Sample Body") and len(sample.data.polygons) == 13_486
    bpy.ops.cloak.ready_cloak(cloak="builtin-sample")
    assert bpy.context.object is sample and colors.is_dressed(sample)
    assert Path(sample.cloak.run).parent == Path(bpy.context.scene.cloak.output)
    bpy.ops.cloak.bake(size=1024)
    bpy.context.view_layer.objects.active = ready
    bpy.ops.cloak.ready_cloak(cloak="transfer-people")
    assert bpy.context.object not in (sample, ready) and colors.is_dressed(bpy.context.object)


def test_try_it_goes_from_nothing_to_a_picture_before_and_after(stub, tmp_path, monkeypatch, coarse_renders):
    told = []
    monkeypatch.setattr(judging, "tell_status", told.append)
    bpy.context.scene.cloak.output = str(tmp_path / "runs")
    bpy.context.scene.frame_end = 500
    bpy.ops.cloak.try_it()
    job = run_job(400)
    assert bpy.context.scene.frame_end == 500
    assert bpy.context.object.cloak.logo == "front", "the chest alone is seen after 100 steps"
    assert {words.partition(":")[0] for words in told} == {"Sample body", "Training", "Render check", ""} and not told[
        -1
    ]
    assert any("Render check 2/" in words for words in told), "how far it is"
    picture = bpy.data.images["0.90 before, 0.10 after: scores, reported from 0.5"]
    before, after = np.split(pictures.image_pixels(picture)[..., :3], 2, axis=1)
    assert before.shape == after.shape == (416, 416, 3) and picture.packed_file
    reddish = [((pixels[..., 0] > 0.6) & (pixels[..., 1] < 0.3)).mean() for pixels in (before, after)]
    assert reddish[0] < 0.01 < reddish[1], "the stub's cloak is red"
    assert (job.label, job.state) == ("Render check", "done"), job.message
    assert [session.job_of(kind).state for kind in ("Sample body", "Training")] == ["done", "done"]
    assert (
        session.job_of("Training").progress.steps == 100
        and bpy.context.scene.view_settings.view_transform == "Standard"
    )
    assert "person detected in 0 of 2 renders with the cloak" in job.message


def test_where_no_network_is_allowed_the_trainer_is_told():
    system = bpy.context.preferences.system
    for allowed in (True, False):
        system.use_online_access = allowed
        assert ("CLOAK_OFFLINE" in program.clean_environment()) == (not bpy.app.online_access)


# --- settings ---------------------------------------------------------------------------------------------------------


def test_settings_that_cannot_work_are_named(ready, tmp_path):
    settings = bpy.context.scene.cloak
    for change, words in (
        ({"angle_first": 20, "angle_last": 10}, "Angles 20 to 10"),
        ({"backgrounds": str(tmp_path / "none")}, "Backgrounds folder .* does not exist"),
        ({"config": "/x.toml"}, "Settings File: /x.toml does not exist"),
        ({"output": "/proc/cloak"}, "cannot be written"),
        ({"output": "//runs"}, "save that first"),
    ):
        before = {key: getattr(settings, key) for key in change}
        for key, value in change.items():
            setattr(settings, key, value)
        with pytest.raises(RuntimeError, match=words):
            bpy.ops.cloak.train_start()
        assert re.search(words, train_reason(bpy.context)) or "output" in change
        assert session.job is None and not ready.cloak.run
        for key, value in before.items():
            setattr(settings, key, value)


# --- jobs ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line",
    [b"", b"{", b"[]", b"3", b"null", b'{"step": 4}', b'{"type": 3}', b"\xff\xfe", b"[" * 100_000, b'{"type": "step"}'],
)
def test_no_line_can_upset_the_progress(line):
    before = Progress(step=3, steps=9, loss=0.5)
    after = take_event(before, line)
    assert (after.step, after.steps, after.loss) == (3, 9, 0.5)


def events(*of: dict) -> Progress:
    return functools.reduce(take_event, [json.dumps(event).encode() for event in of], Progress())


def steps(**seconds: float) -> list[dict]:
    """Events of steps "s1" and so on, at these seconds."""
    return [{"type": "step", "step": int(name[1:]), "time": at} for name, at in seconds.items()]


START = {"type": "start", "step": 0, "time": 0, "steps": 10}


@pytest.mark.parametrize(
    ("of", "words"),
    [
        ([], "0/?"),
        ([START], "0/10"),
        ([START, *steps(s1=2, s2=4)], "2/10, 16 s left"),
        ([START, *steps(s1=2, s2=4, s3=14)], "3/10, 20 s left"),  # a tenth of the pace is the latest step's
        ([START, *steps(s4=8)], "4/10, 12 s left"),
        ([START, *steps(s1=2, s2=1)], "2/10, 15 s left"),  # a clock that was set back
        ([START, *steps(s1=20, s2=40)], "2/10, 3 min left"),
        ([START, *steps(s1=500, s2=1000)], "2/10, 1 h 06 min left"),
        ([START, *steps(s10=20)], "10/10"),
        ([START, *steps(s12=20)], "12/10"),
        ([START, *steps(s4=8), START | {"type": "resume", "step": 4, "steps": 20}], "4/20"),
        ([START, *steps(s4=8), *steps(s2=9)], "4/10, 12 s left"),
    ],
)
def test_how_far_a_training_is_and_how_long_it_goes_on(of, words):
    progress = events(*of)
    assert progress.describe() == words
    assert progress.fraction == min(1, progress.step / max(1, progress.steps))


def test_the_success_is_a_mean_of_the_last_steps_and_no_word_is_a_number():
    shown = [{"success": x, "loss": y} for x, y in ((1, 0.5), (0, 0.25), (True, "x"), (math.inf, math.nan))]
    progress = events(START, *(event | s for event, s in zip(steps(s1=1, s2=2, s3=3, s4=4), shown, strict=True)))
    assert progress.success == pytest.approx(0.95) and progress.loss is None and progress.step == 4
    assert events(START, *steps(s1=1), {"type": "end", "outcome": "done"}).outcome == "done"
    failed = events(START, {"type": "error", "message": "no memory"})
    assert (failed.outcome, failed.why) == ("failed", "no memory")
    assert events(START, {"type": "error", "message": "no memory"}, *steps(s1=1)).why == ""


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
    job._begun -= 150
    assert job.describe() == "Long, 3 min", "without a log of events how long it has been at work"
    job.cancel()
    assert job.describe() == "Long (stopping)"
    assert (job.wait(120).state, job.message) == ("stopped", "Long stopped")


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


@pytest.mark.parametrize("mode", ["SCULPT", "TEXTURE_PAINT"])
def test_what_a_job_brings_waits_until_the_mode_is_left_whose_strokes_it_would_spoil(tmp_path, stub, mode):
    make_egg(8)
    set_mode(mode)
    job = jobs.launch(Job("One", [[str(stub), "-c", "pass"]], tmp_path, "one"))
    job._process.wait()
    assert jobs.tick() == jobs.TICK_SECONDS and job.running
    set_mode("OBJECT")
    assert run_job().state == "done"


def test_run_folders_never_collide(tmp_path):
    first = runs.new_run(tmp_path, "a:b", "c*?")
    assert first.name == "a_b c_"
    runs.input_folder(first).mkdir()
    assert runs.new_run(tmp_path, "a:b", "c*?").name == "a_b c_ 2"
    assert runs.new_run(tmp_path, "..", "..").name == "run" or ".." not in runs.new_run(tmp_path, "..", "..").parts


def test_no_timer_acts_while_a_tool_is_at_work():
    """Each that is registered anywhere waits."""
    timers = []
    for name, module in [
        (n, m) for n, m in sys.modules.items() if n.startswith("cloak.") and getattr(m, "__file__", 0)
    ]:
        for timer in re.findall(r"timers\.register\(([\w.]+)", Path(module.__file__).read_text()):
            timers.append(f"{name}.{timer}")
            assert hasattr(operator.attrgetter(timer)(module), "__wrapped__"), timers[-1]
    assert len(timers) >= 4


def test_the_line_that_installs_the_trainer_names_the_wheel_that_was_chosen(nowhere):
    preferences().wheel = "~/my wheels/cloak_core-2.0.0-py3-none-any.whl"
    try:
        with pytest.raises(InputError) as error:
            program.trainer()
        assert str(error.value).endswith(
            f'uv tool install "{nowhere}/my wheels/cloak_core-2.0.0-py3-none-any.whl[onnx]"'
        )
    finally:
        preferences().wheel = ""
