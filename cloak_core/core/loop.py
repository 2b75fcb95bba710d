"""The loop of one run: from its last checkpoint, or its start, to its end, and everything about losing nothing."""

import contextlib
import dataclasses
import time
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.batches import Batch, Batcher, Prefetcher
from cloak_core.core.checkpoints import (
    Checkpoint,
    load_checkpoint,
    receive_checkpoint,
    save_checkpoint,
    send_checkpoint,
)
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.core.events import EventLog, OnEvent, read_events, rewind_events
from cloak_core.core.objective import Objective, Step, StepFigures, gradient_step
from cloak_core.core.optimizer import ColorOptimizer, learning_rate
from cloak_core.core.run_folder import RunFolder, save_preview
from cloak_core.core.settings import TrainSettings
from cloak_core.core.stopping import StopRequest
from cloak_core.core.world import LostProcess, World
from cloak_core.exchange.colors import write_colors
from cloak_core.files.errors import InputError

LIVE_SECONDS = 2.0
"""Between writes of colors.npy while a run goes on: Blender shows them on the model."""


class TrainingError(InputError):
    """Training cannot go on: the loss or its gradient is not finite. The last checkpoint stands; exit code 2.

    Colours cannot overflow (they stay in [0, 1]), so it is the detector that returned NaN or infinity.
    """


@dataclasses.dataclass(frozen=True, eq=False)
class RunResult:
    """How a run ended."""

    out: Path
    """The run folder."""
    step: int
    """Steps done, earlier parts of a resumed run included."""
    steps: int
    """Steps that were asked for."""
    seconds: float
    """Training time, earlier parts of a resumed run included."""
    figures: StepFigures | None
    """Of the last step, from the event log where this call had nothing left to do; None when even that is lost."""
    stopped: str
    """Why it was ended early ("SIGINT", "cancel file", "time budget"); "" when it is complete."""
    colors: np.ndarray
    """[L, 3] float32: those in colors.npy."""
    report: dict[str, float] = dataclasses.field(default_factory=dict)
    """What techniques measured of the colours."""

    def record(self) -> dict:
        """Make the record that the command line prints."""
        figures = dataclasses.asdict(self.figures) if self.figures else {}
        record = {
            "out": str(self.out),
            "step": self.step,
            "steps": self.steps,
            "seconds": round(self.seconds, 2),
            "distinct_colors": len(np.unique(self.colors, axis=0)),
        }
        stopped = {"stopped": f"stopped at step {self.step}: {self.stopped}"} if self.stopped else {}
        return record | self.report | figures | stopped


class TrainingLoop:
    """One run from its last checkpoint (or its start) to its end."""

    def __init__(
        self,
        settings: TrainSettings,
        run: RunFolder,
        batcher: Batcher,
        objective: Objective,
        optimizer: ColorOptimizer,
        on_event: OnEvent | None,
        world: World,
    ) -> None:
        self.run = run
        self.batcher = batcher
        self.objective = objective
        self.techniques = objective.techniques
        self.settings = settings
        self.sampler = batcher.sampler
        self.optimizer = optimizer
        self.world = world
        self.step = 0
        self._earlier = 0.0
        self._started = self._shown = time.perf_counter()
        self._damaged = self._restore()
        # Rank 0 alone writes; the others only compute.
        self.log = EventLog(run.events, on_event) if world.is_first else None
        self.batches = Prefetcher(batcher, world.rank, world.size)

    def run_to_end(self, stop: StopRequest) -> RunResult:
        """Train until done or told to stop; a checkpoint and the colours are written either way."""
        try:
            figures, reason = self._steps(stop)
        finally:
            self.batches.close()
            if self.log:
                self.log.close()
        colors = self.optimizer.finished()
        return RunResult(
            out=self.run.path,
            step=self.step,
            steps=self.sampler.steps,
            seconds=self.seconds,
            figures=figures or self._recorded_figures(),
            stopped=reason,
            colors=self._on_faces(colors),
            report=self.techniques.report(_as_array(colors)),
        )

    def _steps(self, stop: StopRequest) -> tuple[StepFigures | None, str]:
        figures = None
        reason = ""
        changes = {"changes": self.run.changes} if self.run.changes else {}
        self._tell("resume" if self.step else "start", steps=self.sampler.steps, damaged=self._damaged, **changes)
        try:
            while not self._is_done() and not reason:
                figures = self._one_step()
                if self.world.is_first and self._due(self.settings.run.snapshot_every):
                    self._write_snapshot()
                reason = self.world.agree(stop.reason(self.seconds), self.batcher.device)
                if self._is_done() or reason or self._due(self.settings.run.checkpoint_every):
                    self._save()
                else:
                    self._show()
        except LostProcess as lost:
            self._save()
            message = f"{self.run.path}: lost another process of this run after step {self.step} ({lost})"
            raise TrainingError(f"{message}; a checkpoint is written, --resume goes on") from None
        except InputError:
            # A background that vanished, a detector gone wrong: keep what was reached, unless the disk is the trouble.
            with contextlib.suppress(InputError):
                self._save()
            raise
        reason = "" if self._is_done() else reason
        self._tell("end", outcome="stopped" if reason else "done", reason=reason)
        return figures, reason

    def _is_done(self) -> bool:
        return self.step >= self.sampler.steps

    def _recorded_figures(self) -> StepFigures | None:
        """Read the last step's figures from the event log: a run that was complete before has no others."""
        names = [field.name for field in dataclasses.fields(StepFigures)]
        for event in reversed(read_events(self.run.events) if self.world.is_first else []):
            if event.get("type") == "step" and all(isinstance(event.get(name), float) for name in names):
                return StepFigures(*(event[name] for name in names))
        return None

    @property
    def seconds(self) -> float:
        """Training time so far, earlier parts included; from a clock that cannot run backwards."""
        return self._earlier + time.perf_counter() - self._started

    def _one_step(self) -> StepFigures:
        lr = learning_rate(self.settings.optimization, self.step, self.sampler.steps, self.sampler.epoch_of(self.step))
        self.optimizer.reach(self.step, self.sampler.steps)
        batch = self.batches.batch(self.step)
        part = len(batch) / self.sampler.images_of(self.step)
        step = self._gradient(batch, part)
        if not step.is_finite:
            self._refuse(step)
        self._watch(step)
        self.optimizer.update(lr)
        self.step += 1
        self._tell("step", **dataclasses.asdict(step.figures), **self._facts(lr))
        # A run that is shorter than the time between previews has one at its end.
        is_short_and_done = self.step == self.sampler.steps < self.settings.run.preview_every
        if self.world.is_first and (self._due(self.settings.run.preview_every) or is_short_and_done):
            path = self.run.previews / f"step-{self.step:08d}.png"
            save_preview(path, step.images, next(iter(step.detections.values())), self.settings.run.threshold)
            self._tell("preview", path=f"previews/{path.name}")
        return step.figures

    def _gradient(self, batch: Batch, part: float) -> Step:
        """Leave the gradient of a batch in the optimizer. `part`: this process's fraction of the batch's images."""
        return gradient_step(self.objective, self.optimizer, batch, self.world, part, self.step)

    def _facts(self, lr: float) -> dict[str, object]:
        """Say what the event of a step holds beside its figures."""
        return {"lr": lr}

    def _watch(self, step: Step) -> None:
        """Tell techniques how surely each detector found a person in the batch's images, every process's."""
        device = self.batcher.device
        for technique in self.techniques.at("observe"):
            asked = self.objective.ensemble.asked(self.step)
            total = torch.zeros(len(asked), dtype=torch.float64, device=device)
            for place, number in enumerate(asked):
                if number in step.detections:
                    point = self.objective.detectors[number].operating_point
                    total[place] = technique.level(max_person_score(step.detections[number]).double(), point).sum()
            mean = (self.world.sum(total) / self.sampler.images_of(self.step)).tolist()
            technique.observe(dict(zip(asked, mean, strict=True)))

    def _refuse(self, step: Step) -> None:
        names = [
            self.objective.detectors[number].spec
            for number, detections in step.detections.items()
            if not (torch.isfinite(detections.scores).all() and torch.isfinite(detections.boxes).all())
        ]
        blame = f"; not finite: the output of {', '.join(names)}" if names else ""
        what = "its loss" if not np.isfinite(step.figures.loss) else "the gradient of its loss"
        self._tell("error", message=f"{what} is not finite")
        raise TrainingError(
            f"{self.run.path}: step {self.step}: {what} is not finite{blame}; colours are left as before"
        )

    def _due(self, every: int) -> bool:
        return every > 0 and self.step % every == 0

    def _tell(self, kind: str, **more: object) -> None:
        if self.log:
            self.log.write({"type": kind, "step": self.step, "time": round(self.seconds, 4)} | more)

    def _on_faces(self, colors: Float[Tensor, "N 3"]) -> Float[np.ndarray, "L 3"]:
        """Give the colours of the logo's faces: of a cloth, the mean of the squares on each face.

        Where a technique restricts colours the mean might not be allowed; then it is the colour of the square under the
        face's centre.
        """
        is_exact = any(technique.is_exact for technique in self.techniques)
        return self.batcher.pattern.on_faces(_as_array(colors), is_exact)

    def _save(self) -> None:
        """Write a checkpoint and the colours."""
        if self.world.is_first:
            self._write_colors()
            tensors = self.optimizer.state() | self.techniques.state()
            save_checkpoint(self.run.checkpoint, Checkpoint(self.step, self.seconds, tensors))
            self._tell("checkpoint")

    def _write_snapshot(self) -> None:
        colors = self.optimizer.finished()
        self.run.write_snapshot(self.step, self._on_faces(colors), self.batcher.pattern.picture(_as_array(colors)))

    def _show(self) -> None:
        """Write the colours every now and then, for whoever watches."""
        if self.world.is_first and time.perf_counter() - self._shown >= LIVE_SECONDS:
            self._write_colors()

    def _write_colors(self) -> None:
        """Write the cloth, where one is trained, then the faces' colours: whoever watches these finds both new."""
        colors = self.optimizer.finished()
        picture = self.batcher.pattern.picture(_as_array(colors))
        if picture is not None:
            self.run.write_cloth(picture)
        write_colors(self.run.colors, self._on_faces(colors))
        self._shown = time.perf_counter()

    def _restore(self) -> list[str]:
        """Load the last sound checkpoint, if any, in every process; returns what was wrong with later ones."""
        checkpoint, damaged = self.world.on_rank0(lambda: load_checkpoint(self.run.checkpoint)) or (None, [])
        checkpoint = receive_checkpoint(self.world.broadcast(send_checkpoint(checkpoint)))
        if checkpoint is not None:
            try:
                self.optimizer.load(checkpoint.tensors)
                self.techniques.load(checkpoint.tensors)
            except (KeyError, ValueError) as error:
                raise InputError(f"{self.run.checkpoint}: holds another run's state ({error})") from None
            self.step = checkpoint.step
            self._earlier = checkpoint.time
        if self.world.is_first:
            rewind_events(self.run.events, self.step)
        return damaged


def _as_array(colors: Tensor) -> Float[np.ndarray, "L 3"]:
    return colors.detach().cpu().numpy().astype(np.float32, copy=True)
