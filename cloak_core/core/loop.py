"""The loop of whatever goes step by step: its clock, log, checkpoints, stop and resume, and losing nothing.

A cancel file, a signal or a spent time budget ends it in order; that is asked once per step.

Training, a search by questions and hardening each hand it a step (`Loop.one_step`) and their state.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import torch
from torch import Tensor

from cloak_core.core.checkpoints import (
    Checkpoint,
    load_checkpoint,
    receive_checkpoint,
    remove_unfinished,
    save_checkpoint,
    send_checkpoint,
)
from cloak_core.core.events import EventLog, OnEvent, rewind_events
from cloak_core.core.world import ALONE, LostProcess, World
from cloak_core.files.errors import InputError
from cloak_core.files.writing import is_taken, lock, new_folder, remove_all_leftovers, written

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Says why to stop, or "" to go on."""

    def __init__(self, cancel_file: Path, max_seconds: float | None) -> None:
        self._cancel_file = cancel_file
        self._max_seconds = max_seconds
        self.signal: str = ""

    def reason(self, seconds: float) -> str:
        """Give the reason to stop after `seconds` of training."""
        if self.signal:
            return self.signal
        if self._cancel_file.exists():
            return "cancel file"
        if self._max_seconds is not None and seconds >= self._max_seconds:
            return "time budget"
        return ""


@contextlib.contextmanager
def stop_request(cancel_file: Path, max_seconds: float | None = None) -> Iterator[StopRequest]:
    """Listen for SIGINT and SIGTERM during the block; a second one acts as it would without us.

    Outside the main thread, where Python takes no handlers, only the file and the budget count.
    """
    request = StopRequest(cancel_file, max_seconds)
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    previous = {number: signal.getsignal(number) for number in SIGNALS}

    def remember(number: int, frame: object) -> None:
        request.signal = signal.Signals(number).name
        signal.signal(number, previous[number])

    for number in SIGNALS:
        signal.signal(number, remember)
    try:
        yield request
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


class TrainingError(InputError):
    """Training cannot go on: the loss or its gradient is not finite. The last checkpoint stands; exit code 2.

    Colours cannot overflow (they stay in [0, 1]), so it is the detector that returned NaN or infinity.
    """


class LoopFolder:
    """Paths of a folder that a loop writes into. Make one with `opened`."""

    work = "working"
    """What is done in the folder, for who finds it in use."""
    folders: tuple[str, ...] = ("checkpoint",)
    """Folders of its own in it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config = path / "config.json"
        self.events = path / "events.jsonl"
        self.checkpoint = path / "checkpoint"
        self.cancel = path / "cancel"

    @contextlib.contextmanager
    def opened(self, resume: bool, start: Callable[[Path], None], check: Callable[[], None]) -> Iterator[None]:
        """Create the folder, or open it to resume; nobody else works in it until the block ends.

        start: writes what a new folder begins with; check: refuses to go on with what it holds. InputError: it exists
        and is not to be resumed, holds something else, or is in use. Resuming what does not exist yet starts it, so
        that one command serves every restart.
        """
        path = self.path
        if is_taken(path) and not resume:
            raise InputError(f"{path}: exists already (--resume goes on with it)")
        if not is_taken(path):
            try:
                with new_folder(path) as temporary:
                    start(temporary)
                    for name in self.folders:
                        (temporary / name).mkdir()
            except InputError:
                # Another process may have been quicker by a moment; whose folder it is then, is asked below.
                if not (resume and path.exists()):
                    raise
        if not self.config.exists():
            raise InputError(f"{path}: not a folder of {self.work} (no config.json in it)")
        with lock(path / ".lock", busy=f"{path}: another process is {self.work} in this folder"):
            check()
            for name in self.folders:
                # A folder may come from elsewhere; nothing of it may lead outside.
                folder = path / name
                if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
                    raise InputError(f"{folder}: not a folder of its own")
                with written(folder):
                    folder.mkdir(exist_ok=True)
                remove_all_leftovers(folder)
            remove_unfinished(self.checkpoint)
            remove_all_leftovers(path)
            with written(self.cancel):
                self.cancel.unlink(missing_ok=True)
            yield


class Loop:
    """Steps from the last checkpoint, or the start, to the end."""

    def __init__(
        self,
        folder: LoopFolder,
        steps: int,
        checkpoint_every: int,
        on_event: OnEvent | None = None,
        world: World = ALONE,
        device: torch.device | str = "cpu",
    ) -> None:
        """steps: asked for; checkpoint_every: steps between checkpoints, 0 writes one at the end."""
        self.folder, self.steps, self.checkpoint_every = folder, steps, checkpoint_every
        self.world = world
        self.device = torch.device(device)
        self.step = 0
        self._earlier = 0.0
        self._started = time.perf_counter()
        self._damaged = self._restore()
        # Rank 0 alone writes; the others only compute.
        self.log = EventLog(folder.events, on_event) if world.is_first else None

    # --- what a kind of work hands over

    def one_step(self) -> None:
        """Do one step: count it in `step` and tell it."""
        raise NotImplementedError

    def state(self) -> Mapping[str, Tensor]:
        """Give everything that later steps depend on."""
        raise NotImplementedError

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state()`. KeyError, ValueError or RuntimeError: the tensors belong to other work."""
        raise NotImplementedError

    def show(self) -> None:
        """Write what whoever watches sees, after a step without a checkpoint."""

    def write_result(self) -> None:
        """Write what was reached, beside a checkpoint."""

    # --- the loop

    def run(self, stop: StopRequest, **fields: object) -> str:
        """Step until done or told to stop, with a checkpoint either way; returns why it ended early, "" where not.

        fields: more of the first event.
        """
        reason = ""
        self.tell("resume" if self.step else "start", steps=self.steps, **fields)
        try:
            while not self.is_done() and not reason:
                self.one_step()
                reason = self.world.agree(stop.reason(self.seconds), self.device)
                if self.is_done() or reason or self.due(self.checkpoint_every):
                    self.save()
                elif self.world.is_first:
                    self.show()
        except LostProcess as lost:
            self.save()
            message = f"{self.folder.path}: lost another process of this run after step {self.step} ({lost})"
            raise TrainingError(f"{message}; a checkpoint is written, --resume goes on") from None
        except InputError:
            # A background that vanished, a detector gone wrong: keep what was reached, unless the disk is the trouble.
            with contextlib.suppress(InputError):
                self.save()
            raise
        return "" if self.is_done() else reason

    def is_done(self) -> bool:
        """Whether all steps are done."""
        return self.step >= self.steps

    @property
    def seconds(self) -> float:
        """Time so far, earlier parts included; from a clock that cannot run backwards."""
        return self._earlier + time.perf_counter() - self._started

    def due(self, every: int) -> bool:
        """Tell whether this step ends a turn of `every` steps; with 0 none does."""
        return every > 0 and self.step % every == 0

    def tell(self, kind: str, **more: object) -> None:
        """Log an event."""
        if self.log:
            self.log.write({"type": kind, "step": self.step, "time": round(self.seconds, 4)} | more)

    def close(self) -> None:
        """Close the log."""
        if self.log:
            self.log.close()

    def save(self) -> None:
        """Write what was reached, and a checkpoint."""
        if self.world.is_first:
            self.write_result()
            save_checkpoint(self.folder.checkpoint, Checkpoint(self.step, self.seconds, dict(self.state())))
            self.tell("checkpoint")

    def _restore(self) -> list[str]:
        """Load the last sound checkpoint, if any, in every process; returns what was wrong with later ones."""
        checkpoint, damaged = self.world.on_rank0(lambda: load_checkpoint(self.folder.checkpoint)) or (None, [])
        checkpoint = receive_checkpoint(self.world.broadcast(send_checkpoint(checkpoint)))
        if checkpoint is not None:
            try:
                self.load(checkpoint.tensors)
            except (KeyError, ValueError, RuntimeError) as error:
                raise InputError(f"{self.folder.checkpoint}: holds another run's state ({error})") from None
            self.step = checkpoint.step
            self._earlier = checkpoint.time
        if self.world.is_first:
            rewind_events(self.folder.events, self.step)
        return damaged
