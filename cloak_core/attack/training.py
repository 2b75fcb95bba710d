"""Training: body + detectors + backgrounds -> the colours of a logo.

One step: draw bodies, cameras, backgrounds and augmentations; compose the images; ask the detectors; move the colours
against the gradient of the loss; keep them in [0, 1]. Everything else here is about never losing a run.
"""

import contextlib
import dataclasses
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from cloak_core.attack.batches import Batcher, require_visible_logo
from cloak_core.attack.checkpoints import Checkpoint, load_checkpoint, save_checkpoint
from cloak_core.attack.events import EventLog, OnEvent, rewind_events
from cloak_core.attack.objective import Objective, StepFigures, gradient_step
from cloak_core.attack.optimizing import ColorOptimizer, initial_colors, learning_rate
from cloak_core.attack.previews import save_preview
from cloak_core.attack.run_config import run_config
from cloak_core.attack.run_folder import RunFolder, open_run
from cloak_core.attack.sampling import Sampler
from cloak_core.attack.settings import TrainSettings
from cloak_core.attack.stopping import StopRequest, stop_request
from cloak_core.detectors.protocol import Detections, Detector, state_hash
from cloak_core.errors import InputError
from cloak_core.render.views import ViewBank
from cloak_core.scene.backgrounds import Backgrounds
from cloak_core.scene.exchange import Bodies, write_colors
from cloak_core.scene.logo import Logo


class TrainingError(InputError):
    """Training cannot go on: the loss or its gradient is not finite. The last checkpoint stands; exit code 2.

    Colours cannot overflow (they stay in [0, 1]), so it is the detector that returned NaN or infinity.
    """


@dataclasses.dataclass(frozen=True, eq=False)
class RunResult:
    """How a run ended."""

    out: Path
    step: int
    steps: int
    seconds: float
    """Training time, earlier parts of a resumed run included."""
    figures: StepFigures | None
    """Of the last step; None when there was nothing left to do."""
    stopped: str
    """Why it ended early ("SIGINT", "cancel file", "time budget"); "" when it is complete."""
    colors: np.ndarray
    """[L, 3] float32."""

    def record(self) -> dict:
        """As the command line prints it."""
        figures = dataclasses.asdict(self.figures) if self.figures else {}
        record = {"out": str(self.out), "step": self.step, "steps": self.steps, "seconds": round(self.seconds, 2)}
        return record | figures | ({"stopped": f"stopped at step {self.step}: {self.stopped}"} if self.stopped else {})


def train(
    settings: TrainSettings,
    bodies: Bodies,
    logo: Logo,
    detectors: Sequence[Detector],
    backgrounds: Backgrounds,
    out: str | os.PathLike,
    *,
    resume: bool = False,
    on_event: OnEvent | None = None,
    inputs: Mapping[str, str] | None = None,
) -> RunResult:
    """Train the logo's colours into the run folder `out`.

    The loss is the mean over `detectors` of their disappearance loss, plus weighted total variation. `on_event` hears
    every event that goes to events.jsonl. `inputs` (paths and specs, as the user gave them) are recorded.
    SIGINT, SIGTERM, a file `cancel` in `out` or the time budget end it after the current step with a checkpoint;
    `resume` then continues to the bit-identical result on the same device and number of threads.

    Raises InputError: `out` exists (without `resume`), belongs to other inputs or is in use; the logo is another
    body's, or no training view sees it; a detector cannot be trained against. TrainingError: the loss is not finite.
    """
    if not detectors:
        raise InputError("--detector: none given")
    for detector in detectors:
        if not detector.differentiable:
            raise InputError(f"--detector {detector.spec}: gives no gradients, so nothing can be trained against it")
    if logo.topology != bodies.topology:
        raise InputError(f"the logo: made for topology {logo.topology}, but the scene has {bodies.topology}")
    device = _device(settings.device)
    with _threads(settings.threads):
        bank = ViewBank(bodies, device=device, **({"samples": settings.samples} if settings.samples else {}))
        require_visible_logo(bank, logo.face_ids, bodies.pose_count, settings)
        states = [state_hash(detector) for detector in detectors]
        config = run_config(settings, bodies, logo, detectors, states, backgrounds, inputs or {})
        with open_run(Path(out), config, logo, resume) as run, stop_request(run.cancel, settings.max_seconds) as stop:
            sampler = Sampler(settings, bodies.pose_count, bodies.outfit_count, len(backgrounds))
            batcher = Batcher(settings, sampler, bank, logo.face_ids, backgrounds, device)
            result = Trainer(run, batcher, bodies, logo, detectors, on_event).run_to_end(stop)
        for detector, state in zip(detectors, states, strict=True):
            if state_hash(detector) != state:
                raise RuntimeError(f"detector {detector.spec} changed during training")
    return result


class Trainer:
    """One run from its last checkpoint (or its start) to its end."""

    def __init__(
        self,
        run: RunFolder,
        batcher: Batcher,
        bodies: Bodies,
        logo: Logo,
        detectors: Sequence[Detector],
        on_event: OnEvent | None,
    ) -> None:
        self.run, self.batcher, self.detectors = run, batcher, detectors
        self.settings, self.sampler = batcher.settings, batcher.sampler
        device = batcher.device
        clothing = torch.from_numpy(bodies.face_colors[0, logo.face_ids]).to(device)
        self.optimizer = ColorOptimizer(self.settings, initial_colors(self.settings, clothing))
        self.objective = Objective(self.settings, logo, detectors, device)
        self.step = 0
        self._earlier = 0.0
        self._started = time.perf_counter()
        self._damaged = self._restore()
        self.log = EventLog(run.events, on_event)

    def run_to_end(self, stop: StopRequest) -> RunResult:
        """Steps until done or told to stop; a checkpoint and the colours are written either way."""
        figures, reason = None, ""
        try:
            self._tell("resume" if self.step else "start", steps=self.sampler.steps, damaged=self._damaged)
            while self.step < self.sampler.steps and not reason:
                figures = self._one_step()
                reason = stop.reason(self.seconds)
                if self.step == self.sampler.steps or reason or self._due(self.settings.checkpoint_every):
                    self._save()
            reason = reason if self.step < self.sampler.steps else ""
            self._tell("end", outcome="stopped" if reason else "done", reason=reason)
        finally:
            self.log.close()
        return RunResult(
            self.run.path, self.step, self.sampler.steps, self.seconds, figures, reason, self._colors_array()
        )

    @property
    def seconds(self) -> float:
        """Training time so far, earlier parts included; from a clock that cannot run backwards."""
        return self._earlier + time.perf_counter() - self._started

    def _one_step(self) -> StepFigures:
        lr = learning_rate(self.settings, self.step, self.sampler.steps, self.sampler.epoch_of(self.step))
        batch = self.batcher.batch(self.step)
        figures, finite, images, detections = gradient_step(self.objective, self.optimizer, batch)
        if not finite:
            self._refuse(figures, detections)
        self.optimizer.update(lr)
        self.step += 1
        self._tell("step", **dataclasses.asdict(figures), lr=lr)
        if self._due(self.settings.preview_every):
            path = self.run.previews / f"step-{self.step:08d}.png"
            save_preview(path, images, detections[0], self.settings.threshold)
            self._tell("preview", path=f"previews/{path.name}")
        return figures

    def _refuse(self, figures: StepFigures, detections: Sequence[Detections]) -> None:
        names = [
            detector.spec
            for detector, said in zip(self.detectors, detections, strict=True)
            if not (torch.isfinite(said.scores).all() and torch.isfinite(said.boxes).all())
        ]
        blame = f"; not finite: the output of {', '.join(names)}" if names else ""
        what = "its loss" if not np.isfinite(figures.loss) else "the gradient of its loss"
        self._tell("error", message=f"{what} is not finite")
        raise TrainingError(
            f"{self.run.path}: step {self.step}: {what} is not finite{blame}; colours are left as before"
        )

    def _due(self, every: int) -> bool:
        return every > 0 and self.step % every == 0

    def _tell(self, kind: str, **more: object) -> None:
        self.log.write({"type": kind, "step": self.step, "time": round(self.seconds, 4), **more})

    def _colors_array(self) -> Float[np.ndarray, "L 3"]:
        return self.optimizer.colors().detach().cpu().numpy().astype(np.float32, copy=True)

    def _save(self) -> None:
        write_colors(self.run.colors, self._colors_array())
        save_checkpoint(self.run.checkpoint, Checkpoint(self.step, self.seconds, self.optimizer.state()))
        self._tell("checkpoint")

    def _restore(self) -> list[str]:
        """Load the last sound checkpoint, if any; returns what was wrong with later ones."""
        checkpoint, damaged = load_checkpoint(self.run.checkpoint)
        if checkpoint is not None:
            try:
                self.optimizer.load(checkpoint.tensors)
            except (KeyError, ValueError) as error:
                raise InputError(f"{self.run.checkpoint}: holds another run's state ({error})") from None
            self.step, self._earlier = checkpoint.step, checkpoint.time
        rewind_events(self.run.events, self.step)
        return damaged


def _device(name: str) -> torch.device:
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"--device {name}: {str(error).splitlines()[0]}") from None
    return device


@contextlib.contextmanager
def _threads(count: int | None) -> Iterator[None]:
    before = torch.get_num_threads()
    if count is not None:
        torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
