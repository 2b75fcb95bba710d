"""What child processes of these tests do; imported by a fork server, so that a child starts in milliseconds."""

import contextlib
import multiprocessing
import os
import secrets  # noqa: F401  one of MOMENTS
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import torch

from cloak_core.core import checkpoints, training
from cloak_core.core.checkpoints import Checkpoint, save_checkpoint
from cloak_core.files.errors import InputError
from cloak_core.studies.sweeps import SweepRun, read_grid
from cloak_core.studies.trainings.training import train
from tests.core.fakes import TinyDetector, box_bodies, front_logo, noise_backgrounds, tiny_settings

STEPS = 30


def start(work: Callable, *arguments: object) -> tuple[multiprocessing.Process, object]:
    """A child at work, and a pipe's end on which it reports numbers."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=work, args=(theirs, *arguments), daemon=True)
    # The fork server finds modules to preload by its environment alone.
    with mock.patch.dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path)):
        process.start()
    theirs.close()
    return process, ours


def whole_run(out: Path, on_event: Callable | None = None):
    """The run that children are killed in: so many checkpoints that most moments fall into a write."""
    torch.set_num_threads(1)
    bodies = box_bodies()
    settings = tiny_settings(steps=STEPS, checkpoint_every=2, preview_every=7)
    return train(settings, bodies, front_logo(bodies), [TinyDetector()], noise_backgrounds(), out, resume=True,
                 on_event=on_event)  # fmt: skip


def drain(pipe: object) -> list[int]:
    """All that a child says, until it ends."""
    said = []
    try:
        while True:
            said.append(pipe.recv())
    except EOFError:
        return said


def tiny_runs(folder: Path) -> list[SweepRun]:
    """Two learning rates with two seeds each; their material comes from `tiny_material`."""
    base = "scene = 'box'\nlogo = 'front'\nsteps = 4\nbatch = 3\nsize = 64\ntranslation = 5\nsamples = 1\n"
    base += "angles = '-10,10'\ncheckpoint_every = 2\npreview_every = 3\n"
    grid = folder / "tiny.toml"
    grid.write_text(f"[base]\n{base}\n[grid]\nlr = [0.02, 0.05]\nseed = [0, 1]\n")
    return read_grid(grid)


def tiny_material(run: object) -> tuple:
    """In place of what a grid's names stand for."""
    bodies = box_bodies()
    return bodies, front_logo(bodies), [TinyDetector()], noise_backgrounds()


def nothing(pipe: object) -> None:
    pass


def train_and_tell(pipe: object, out: str) -> None:
    whole_run(Path(out), lambda event: pipe.send(event["step"]))
    pipe.send(-1)


def write_checkpoints(pipe: object, folder: str) -> None:
    for step in range(1, 100_000):
        save_checkpoint(Path(folder), Checkpoint(step, 0.0, {"parameter": torch.full((20_000, 3), float(step))}))
        pipe.send(step)


# --- killed in the middle of a write ---------------------------------------------------------------------------------

MOMENTS = ("os.fsync", "os.replace", "os.unlink", "os.rmdir", "os.mkdir", "secrets.token_hex")
"""Every call by which a run's files appear, change and vanish."""


def train_and_die(pipe: object, out: str, moment: int) -> None:
    """The run, killed just before call number `moment` of MOMENTS, or half-way through writing a checkpoint's file.

    Tells how many such moments there were, where none of them was the last.
    """
    count = 0

    def here() -> bool:
        nonlocal count
        count += 1
        return count == moment

    def die() -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    def deadly(call: Callable) -> Callable:
        return lambda *args, **kwargs: die() if here() else call(*args, **kwargs)

    def torn(path: Path, data: bytes) -> None:
        if here():
            path.write_bytes(data[: len(data) // 2])
            die()
        write(path, data)

    write = checkpoints.write_bytes
    with contextlib.ExitStack() as stack:
        stack.enter_context(mock.patch.object(checkpoints, "write_bytes", torn))
        for name in MOMENTS:
            module, _, call = name.partition(".")
            found = getattr(sys.modules[module], call)
            stack.enter_context(mock.patch.object(sys.modules[module], call, deadly(found)))
        # Colours are shown after every step without a checkpoint, so that their writes are met as well.
        stack.enter_context(mock.patch.object(training, "LIVE_SECONDS", 0.0))
        whole_run(Path(out))
    pipe.send(count)


def train_and_answer(pipe: object, out: str) -> None:
    """The run; tells how it was refused, or "done"."""
    try:
        whole_run(Path(out))
    except InputError as error:
        pipe.send(str(error))
    else:
        pipe.send("done")


def train_and_weigh(pipe: object, out: str, steps: int) -> None:
    """A longer run; tells the resident memory in bytes after every step."""
    torch.set_num_threads(1)
    bodies = box_bodies()
    settings = tiny_settings(steps=steps, checkpoint_every=20, preview_every=50)
    page = os.sysconf("SC_PAGE_SIZE")

    def weigh(event: dict) -> None:
        if event["type"] == "step":
            pipe.send(page * int(Path("/proc/self/statm").read_text().split()[1]))

    train(settings, bodies, front_logo(bodies), [TinyDetector()], noise_backgrounds(), Path(out), on_event=weigh)
