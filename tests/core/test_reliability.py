"""Runs that are killed, starved of disk or locked out: nothing is lost, and what resumes ends in the same bits.

CLOAK_KILLS sets how many kills (50 for the figures in docs/reports/reliability.md, which CLOAK_WRITE_DOCS=1 rewrites).
"""

import contextlib
import json
import os
import random
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloak_core.core.checkpoints import load_checkpoint
from cloak_core.core.events import read_events
from cloak_core.exchange.face_lists import read_colors, read_face_list
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.studies.trainings.training import TrainingError
from tests.core import children
from tests.core.fakes import BrokenDetector, TinyDetector, box_bodies, front_logo
from tests.core.test_training import run
from tests.reliability_record import record

KILLS = int(os.environ.get("CLOAK_KILLS", "6"))
MEMORY_STEPS = int(os.environ.get("CLOAK_MEMORY_STEPS", "600"))
pytestmark = pytest.mark.reliability


def loads(folder: Path) -> None:
    """Whatever is there is whole."""
    if not folder.exists():
        return
    json.loads((folder / "config.json").read_text())
    assert (read_face_list(folder / "logo.npy", box_bodies()).ids == front_logo(box_bodies()).face_ids).all()
    if (folder / "colors.npy").exists():
        read_colors(folder / "colors.npy", 16)
    assert load_checkpoint(folder / "checkpoint")[1] == []
    if (folder / "events.jsonl").exists():
        read_events(folder / "events.jsonl")


def ends_alike(folder: Path, colors: np.ndarray) -> None:
    """Resumed, the run reaches these very colours, has told every step once, and has tidied up."""
    assert np.array_equal(children.whole_run(folder).colors, colors)
    assert np.array_equal(read_colors(folder / "colors.npy"), colors)
    steps = [e["step"] for e in read_events(folder / "events.jsonl") if e["type"] == "step"]
    assert steps == list(range(1, children.STEPS + 1))
    unfinished = {path.name for path in folder.rglob(".*")}
    assert unfinished == {".lock"}


@pytest.fixture
def whole(tmp_path):
    """The colours of the uninterrupted run, and how long it takes."""
    children.drain(children.start(children.nothing)[1])  # the fork server takes its time to start
    process, pipe = children.start(children.train_and_tell, str(tmp_path / "whole"))
    first = time.perf_counter()
    assert children.drain(pipe)[-1] == -1
    duration = time.perf_counter() - first
    process.join()
    return read_colors(tmp_path / "whole" / "colors.npy"), duration


@pytest.mark.long
def test_killed_at_random_moments_and_resumed(tmp_path, whole):
    colors, duration = whole
    draw = random.Random(0)
    reached = []
    for number in range(KILLS - KILLS // 2):
        out = tmp_path / str(number)
        process, pipe = children.start(children.train_and_tell, str(out))
        time.sleep(draw.uniform(0, duration))
        process.kill()
        said = children.drain(pipe)
        process.join()
        reached.append(max(said, default=0) if -1 not in said else children.STEPS)
        loads(out)
        ends_alike(out, colors)
    assert min(reached) < children.STEPS
    within = sum(0 < step < children.STEPS for step in reached)
    record("Killed", "runs killed (SIGKILL) at a random moment", len(reached))
    record("Killed", "of these within their steps (others before the first or after the last)", within)


@pytest.mark.long
def test_killed_in_the_middle_of_writes_and_resumed(tmp_path, whole):
    colors, _ = whole
    process, pipe = children.start(children.train_and_die, str(tmp_path / "counted"), 0)
    (moments,) = children.drain(pipe)
    process.join()
    chosen = random.Random(1).sample(range(1, moments + 1), KILLS // 2)
    for moment in chosen:
        out = tmp_path / str(moment)
        process, pipe = children.start(children.train_and_die, str(out), moment)
        assert children.drain(pipe) == []
        process.join()
        assert process.exitcode == -9
        loads(out)
        ends_alike(out, colors)
    what = "runs killed inside a write: between the system calls that make, flush, rename and remove files"
    record("Killed", f"{what} ({moments} such moments a run), or half-way through a checkpoint's file", len(chosen))
    record("Killed", "run folders that did not load afterwards", 0)
    record("Killed", "resumed runs whose colours differ in any bit from the uninterrupted run's", 0)


@contextlib.contextmanager
def small_disk(folder: Path):
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)], capture_output=True)
    if mounted.returncode:
        pytest.skip("mounting a small tmpfs is not permitted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def fill(disk: Path) -> None:
    with (disk / "ballast").open("ab", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(1024))


def trouble(what: str, error: Exception) -> None:
    """The line a user gets, in the page."""
    said = str(error).replace("|", "\\|")
    for path in sorted({word.strip(":,;()'") for word in said.split() if word.startswith("/")}, key=len, reverse=True):
        said = said.replace(path, Path(path).name)
    assert "\n" not in said
    record("Trouble while training", what, f"`{said}`; earlier results intact, resumed to the same bits")


@pytest.mark.slow
def test_a_full_disk_ends_the_run_and_leaves_what_was_there(tmp_path):
    with small_disk(tmp_path / "disk") as disk:
        with pytest.raises(InputError, match=r"cannot be written \(No space left on device\)") as ended:
            children.whole_run(disk / "run", lambda event: fill(disk) if event["step"] == 9 else None)
        loads(disk / "run")
        assert load_checkpoint(disk / "run" / "checkpoint")[0].step >= 8
        (disk / "ballast").unlink()
        ends_alike(disk / "run", children.whole_run(tmp_path / "whole").colors)
    trouble("the disk is full", ended.value)


@pytest.mark.slow
def test_a_read_only_folder_is_said_and_left_alone(tmp_path):
    with small_disk(tmp_path / "disk") as disk:
        with pytest.raises(InputError, match="is full"):
            children.whole_run(disk / "run", stop_at(9))
        remount = lambda how: subprocess.run(["mount", "-o", f"remount,{how}", str(disk)], check=True)
        remount("ro")
        before = {path: path.read_bytes() for path in disk.rglob("*") if path.is_file()}
        try:
            for name in ("run", "another"):
                with pytest.raises(InputError, match=r"cannot be written \(Read-only file system\)") as ended:
                    children.whole_run(disk / name)
        finally:
            remount("rw")
        assert before == {path: path.read_bytes() for path in disk.rglob("*") if path.is_file()}
        ends_alike(disk / "run", children.whole_run(tmp_path / "whole").colors)
    trouble("the folder is read-only", ended.value)


def stop_at(step: int):
    def stop(event: dict) -> None:
        if event["step"] == step:
            raise InputError("the listener is full")

    return stop


@pytest.mark.slow
@pytest.mark.parametrize("how", ["vanishes", "is truncated"])
def test_a_background_that_goes_bad(tmp_path, monkeypatch, how):
    """And when it is back, the run goes on as if nothing had happened."""
    monkeypatch.setenv("CLOAK_CACHE", "off")  # which would have it still
    (tmp_path / "photos").mkdir()
    for i in range(5):
        pixels = np.random.default_rng(i).integers(0, 255, (80, 90, 3)).astype(np.uint8)
        Image.fromarray(pixels).save(tmp_path / "photos" / f"{i}.png")
    victim = tmp_path / "photos" / "3.png"
    data = victim.read_bytes()

    def attempt(name: str, harm: bool = False):
        def listen(event: dict) -> None:
            if harm and (event["type"], event["step"]) == ("step", 3):
                victim.unlink() if how == "vanishes" else victim.write_bytes(data[: len(data) // 2])

        # Room for one picture, so that files are read again.
        with monkeypatch.context() as patched:
            patched.setattr("cloak_core.sources.backdrops.backgrounds.MEMORY_BYTES", 1)
            backgrounds = load_backgrounds(tmp_path / "photos", (64, 64))
        options = {"steps": 12, "checkpoint_every": 5, "resume": True, "on_event": listen}
        return run(tmp_path / name, backgrounds=backgrounds, **options)

    whole = attempt("whole").colors
    with pytest.raises(InputError, match=r"3\.png") as ended:
        attempt("run", harm=True)
    # The next batch may have been built already.
    assert load_checkpoint(tmp_path / "run" / "checkpoint")[0].step >= 3
    victim.write_bytes(data)
    assert np.array_equal(attempt("run").colors, whole)
    trouble(f"a background {how}", ended.value)


@pytest.mark.slow
@pytest.mark.parametrize("where", ["output", "gradient"])
def test_a_detector_that_returns_nan(tmp_path, where):
    attempt = lambda name, detector: run(tmp_path / name, [detector], steps=8, checkpoint_every=1, resume=True)
    whole = attempt("whole", TinyDetector()).colors
    blame = "its loss is .*the output of tiny:0" if where == "output" else "the gradient of its loss"
    with pytest.raises(TrainingError, match=f"step 3: {blame}") as ended:
        attempt("run", BrokenDetector(4, in_gradient=where == "gradient"))
    assert [e["type"] for e in read_events(tmp_path / "run" / "events.jsonl")][-2:] == ["error", "checkpoint"]
    checkpoint = load_checkpoint(tmp_path / "run" / "checkpoint")[0]
    assert checkpoint.step == 3 and checkpoint.tensors["parameter"].isfinite().all()
    assert np.array_equal(attempt("run", TinyDetector()).colors, whole)
    trouble("a detector returns NaN" + " gradients" * (where == "gradient"), ended.value)


@pytest.mark.slow
def test_the_wall_clock_may_run_backwards(tmp_path, monkeypatch):
    ticks = iter(range(10_000_000, 0, -1))
    monkeypatch.setattr(time, "time", lambda: float(next(ticks)))
    children.whole_run(tmp_path / "run")
    times = [event["time"] for event in read_events(tmp_path / "run" / "events.jsonl")]
    assert times == sorted(times)
    record("Trouble while training", "the clock runs backwards", "no effect: times come from a clock that cannot")


@pytest.mark.long
def test_several_runs_started_into_one_folder(tmp_path, whole):
    """Whoever comes first trains; the others are told, and nothing is mixed."""
    colors, _ = whole
    started = [children.start(children.train_and_answer, str(tmp_path / "run")) for _ in range(4)]
    said = [pipe.recv() for _, pipe in started]
    for process, _ in started:
        process.join()
    # One that comes after the end finds a finished run, and has nothing to do.
    assert "done" in said
    refused = [words for words in said if words != "done"]
    assert all("another process is training in this folder" in words for words in refused), refused
    ends_alike(tmp_path / "run", colors)
    what = "four runs are started into one new folder at once"
    record("Trouble while training", what, f"one trains, {len(refused)} are told `another process is training`")


@pytest.mark.long
def test_memory_stays_flat(tmp_path):
    """The first and the last tenth of a run, after a warm-up of as many steps."""
    warm = MEMORY_STEPS // 10
    process, pipe = children.start(children.train_and_weigh, str(tmp_path / "run"), MEMORY_STEPS + warm)
    weighed = np.array(children.drain(pipe)[warm:], np.float64)
    process.join()
    assert len(weighed) == MEMORY_STEPS
    tenth = MEMORY_STEPS // 10
    first, last = weighed[:tenth].mean(), weighed[-tenth:].mean()
    slope = np.polyfit(np.arange(MEMORY_STEPS), weighed, 1)[0]
    record("Memory", "steps, each weighed (resident memory of the process)", MEMORY_STEPS)
    record("Memory", "last tenth over first tenth", f"{last / first:.4f} ({last / 2**20:.1f} MiB)")
    record("Memory", "slope", f"{slope:.0f} bytes a step")
    assert abs(last / first - 1) < 0.02
