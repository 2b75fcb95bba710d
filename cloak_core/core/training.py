"""A training as a loop: its steps, previews and snapshots, and how it ended."""

import dataclasses
import time
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.batches import Batch, Batcher, Prefetcher
from cloak_core.core.detector import THRESHOLD
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.core.ensemble import sureness
from cloak_core.core.events import OnEvent, read_events
from cloak_core.core.loop import Loop, StopRequest, TrainingError
from cloak_core.core.objective import Objective, Step, StepFigures, gradient_step
from cloak_core.core.optimizer import ColorOptimizer, learning_rate
from cloak_core.core.run_folder import RunFolder, save_preview, write_cloth
from cloak_core.core.settings import TrainSettings
from cloak_core.core.world import World
from cloak_core.exchange.face_lists import write_colors

LIVE_SECONDS = 2.0
"""Between writes of colors.npy while a run goes on: Blender shows them on the model."""


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
        figures = self.figures.record() if self.figures else {}
        record = {
            "out": str(self.out),
            "step": self.step,
            "steps": self.steps,
            "seconds": round(self.seconds, 2),
            "distinct_colors": len(np.unique(self.colors, axis=0)),
        }
        stopped = {"stopped": f"stopped at step {self.step}: {self.stopped}"} if self.stopped else {}
        return record | self.report | figures | stopped


class TrainingLoop(Loop):
    """One run of a training."""

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
        self.batcher = batcher
        self.objective = objective
        self.techniques = objective.techniques
        self.settings = settings
        self.sampler = batcher.sampler
        self.optimizer = optimizer
        self._shown = time.perf_counter()
        super().__init__(run, self.sampler.steps, settings.run.checkpoint_every, on_event, world, batcher.device)
        self.batches = Prefetcher(batcher, world.rank, world.size)

    def run_to_end(self, stop: StopRequest) -> RunResult:
        """Train until done or told to stop; a checkpoint and the colours are written either way."""
        self.figures: StepFigures | None = None
        changes = {"changes": self.folder.changes} if self.folder.changes else {}
        try:
            reason = self.run(stop, damaged=self._damaged, **changes)
            self.tell("end", outcome="stopped" if reason else "done", reason=reason)
        finally:
            self.batches.close()
            self.close()
        colors = self.optimizer.finished()
        return RunResult(
            out=self.folder.path,
            step=self.step,
            steps=self.steps,
            seconds=self.seconds,
            figures=self.figures or self._recorded_figures(),
            stopped=reason,
            colors=self._on_faces(colors),
            report={k: v for technique in self.techniques for k, v in technique.report(_as_array(colors)).items()},
        )

    def _recorded_figures(self) -> StepFigures | None:
        """Read the last step's figures from the event log: a run that was complete before has no others."""
        plain = ("loss", "disappearance", "tv", "success")
        names = (*plain, *(technique.name for technique in self.techniques.at("penalty")))
        for event in reversed(read_events(self.folder.events) if self.world.is_first else []):
            if event.get("type") == "step" and all(isinstance(event.get(name), float) for name in names):
                penalties = {name: event[name] for name in names[len(plain) :]}
                return StepFigures(penalties=penalties, **{name: event[name] for name in plain})
        return None

    def one_step(self) -> None:
        """See `Loop`: draw, paint, ask, loss, gradient, update."""
        epochs = self.step * self.settings.run.batch / self.sampler.epoch_images
        lr = learning_rate(self.settings.optimization, self.step, self.steps, epochs)
        self.optimizer.on_step(self.step, self.steps)
        batch = self.batches.batch(self.step)
        part = len(batch) / self.sampler.images_of(self.step)
        step = self._gradient(batch, part)
        if not step.is_finite:
            self._refuse(step)
        self._watch(step)
        self.optimizer.update(lr)
        self.step += 1
        self.tell("step", **step.figures.record(), **self._facts(lr))
        # A run that is shorter than the time between previews has one at its end.
        is_short_and_done = self.step == self.steps < self.settings.run.preview_every
        if self.world.is_first and (self.due(self.settings.run.preview_every) or is_short_and_done):
            path = self.folder.previews / f"step-{self.step:08d}.png"
            save_preview(path, step.images, next(iter(step.detections.values())), THRESHOLD)
            self.tell("preview", path=f"previews/{path.name}")
        if self.world.is_first and self.due(self.settings.run.snapshot_every):
            colors = self.optimizer.finished()
            picture = self.batcher.pattern.picture(_as_array(colors))
            self.folder.write_snapshot(self.step, self._on_faces(colors), picture)
        self.figures = step.figures

    def _gradient(self, batch: Batch, part: float) -> Step:
        """Leave the gradient of a batch in the optimizer. `part`: this process's fraction of the batch's images."""
        return gradient_step(self.objective, self.optimizer, batch, self.world, part, self.step)

    def _facts(self, lr: float) -> dict[str, object]:
        """Say what the event of a step holds beside its figures."""
        return {"lr": lr}

    def _watch(self, step: Step) -> None:
        """Tell an adaptive ensemble how surely each detector found a person in the batch's images, every process's."""
        ensemble = self.objective.ensemble
        if not ensemble.is_adaptive:
            return
        asked = ensemble.asked(self.step)
        total = torch.zeros(len(asked), dtype=torch.float64, device=self.batcher.device)
        for place, number in enumerate(asked):
            if number in step.detections:
                point = self.objective.detectors[number].operating_point
                total[place] = sureness(max_person_score(step.detections[number]).double(), point).sum()
        mean = (self.world.sum(total) / self.sampler.images_of(self.step)).tolist()
        ensemble.observe(dict(zip(asked, mean, strict=True)))

    def _refuse(self, step: Step) -> None:
        names = [
            self.objective.detectors[number].spec
            for number, detections in step.detections.items()
            if not (torch.isfinite(detections.scores).all() and torch.isfinite(detections.boxes).all())
        ]
        blame = f"; not finite: the output of {', '.join(names)}" if names else ""
        what = "its loss" if not np.isfinite(step.figures.loss) else "the gradient of its loss"
        self.tell("error", message=f"{what} is not finite")
        raise TrainingError(
            f"{self.folder.path}: step {self.step}: {what} is not finite{blame}; colours are left as before"
        )

    def _on_faces(self, colors: Float[Tensor, "N 3"]) -> Float[np.ndarray, "L 3"]:
        """Give the colours of the logo's faces: of a cloth, the mean of the squares on each face.

        Where colours are restricted the mean might not be allowed; then it is the colour of the square under the
        face's centre.
        """
        return self.batcher.pattern.on_faces(_as_array(colors), self.optimizer.coloring.is_restricted)

    def state(self) -> dict[str, Tensor]:
        """See `Loop`."""
        return self.optimizer.state() | self.objective.ensemble.state()

    def load(self, tensors: dict[str, Tensor]) -> None:
        """See `Loop`."""
        self.optimizer.load(tensors)
        self.objective.ensemble.load(tensors)

    def show(self) -> None:
        """See `Loop`: the colours, every now and then."""
        if time.perf_counter() - self._shown >= LIVE_SECONDS:
            self.write_result()

    def write_result(self) -> None:
        """Write the cloth, where one is trained, then the faces' colours: whoever watches these finds both new."""
        colors = self.optimizer.finished()
        picture = self.batcher.pattern.picture(_as_array(colors))
        if picture is not None:
            write_cloth(self.folder.cloth, picture)
        write_colors(self.folder.colors, self._on_faces(colors))
        self._shown = time.perf_counter()


def _as_array(colors: Tensor) -> Float[np.ndarray, "L 3"]:
    return colors.detach().cpu().numpy().astype(np.float32, copy=True)
