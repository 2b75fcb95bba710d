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

from cloak_core.attack.batches import Batcher, Prefetcher, require_visible_logo
from cloak_core.attack.checkpoints import (
    Checkpoint,
    load_checkpoint,
    receive_checkpoint,
    save_checkpoint,
    send_checkpoint,
)
from cloak_core.attack.events import EventLog, OnEvent, read_events, rewind_events
from cloak_core.attack.objective import Objective, Step, StepFigures, gradient_step
from cloak_core.attack.optimizing import ColorOptimizer, initial_colors, learning_rate
from cloak_core.attack.previews import save_preview
from cloak_core.attack.run_config import run_config
from cloak_core.attack.run_folder import RunFolder, open_run
from cloak_core.attack.sampling import Sampler, is_fresh
from cloak_core.attack.settings import TrainSettings
from cloak_core.attack.stopping import StopRequest, stop_request
from cloak_core.attack.world import LostProcess, World, join_world, local_device
from cloak_core.detectors.protocol import Detector, state_hash
from cloak_core.errors import InputError
from cloak_core.render.views import ViewBank
from cloak_core.scene.backgrounds import Backgrounds
from cloak_core.scene.exchange import Bodies, write_colors
from cloak_core.scene.logo import Logo

FRESH_VIEWS_BYTES = 128 << 20
"""Memory for views that are used once."""


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
    """Of the last step, from the event log where this call had nothing left to do; None when even that is lost."""
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
    device = local_device(settings.device)
    try:
        with _threads(settings.threads), join_world(device) as world:
            return _train(settings, bodies, logo, detectors, backgrounds, Path(out), resume, on_event, inputs, world)
    except LostProcess as lost:
        raise TrainingError(f"{out}: lost another process of this run ({lost}); --resume goes on") from None


def _train(
    settings: TrainSettings,
    bodies: Bodies,
    logo: Logo,
    detectors: Sequence[Detector],
    backgrounds: Backgrounds,
    out: Path,
    resume: bool,
    on_event: OnEvent | None,
    inputs: Mapping[str, str] | None,
    world: World,
) -> RunResult:
    device = local_device(settings.device)
    detectors = [detector.to(device) for detector in detectors]
    bank = make_bank(bodies, settings, device)
    require_visible_logo(bank, logo.face_ids, bodies.pose_count, settings)
    states = [state_hash(detector) for detector in detectors]
    config = run_config(settings, bodies, logo, detectors, states, backgrounds, inputs or {}, world.size)
    with contextlib.ExitStack() as stack:
        run = world.first_does(lambda: stack.enter_context(open_run(out, config, logo, resume))) or RunFolder(out)
        stop = stack.enter_context(stop_request(run.cancel, settings.max_seconds))
        sampler = Sampler(settings, bodies.pose_count, bodies.outfit_count, len(backgrounds))
        batcher = Batcher(settings, sampler, bank, logo.face_ids, backgrounds, device)
        result = Trainer(run, batcher, bodies, logo, detectors, on_event, world).run_to_end(stop)
    for detector, state in zip(detectors, states, strict=True):
        if state_hash(detector) != state:
            raise RuntimeError(f"detector {detector.spec} changed during training")
    return result


def make_bank(bodies: Bodies, settings: TrainSettings, device: torch.device) -> ViewBank:
    """The views of a run. Where every image has a camera of its own, keeping views gains nothing."""
    samples = {"samples": settings.samples} if settings.samples else {}
    memory = {"memory_bytes": FRESH_VIEWS_BYTES} if is_fresh(settings) else {}
    return ViewBank(bodies, device=device, **samples, **memory)


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
        world: World,
    ) -> None:
        self.run, self.batcher, self.detectors = run, batcher, detectors
        self.settings, self.sampler = batcher.settings, batcher.sampler
        device = batcher.device
        clothing = torch.from_numpy(bodies.face_colors[0, logo.face_ids]).to(device)
        self.optimizer = ColorOptimizer(self.settings, initial_colors(self.settings, clothing))
        self.objective = Objective(self.settings, logo, detectors, device)
        self.world = world
        self.step = 0
        self._earlier = 0.0
        self._started = time.perf_counter()
        self._damaged = self._restore()
        # Rank 0 alone writes; the others only compute.
        self.log = EventLog(run.events, on_event) if world.is_first else None
        self.batches = Prefetcher(batcher, world.rank, world.size)

    def run_to_end(self, stop: StopRequest) -> RunResult:
        """Steps until done or told to stop; a checkpoint and the colours are written either way."""
        try:
            figures, reason = self._steps(stop)
        finally:
            self.batches.close()
            if self.log:
                self.log.close()
        steps, colors = self.sampler.steps, self._colors_array()
        figures = figures or self._recorded_figures()
        return RunResult(self.run.path, self.step, steps, self.seconds, figures, reason, colors)

    def _steps(self, stop: StopRequest) -> tuple[StepFigures | None, str]:
        figures, reason, steps = None, "", self.sampler.steps
        self._tell("resume" if self.step else "start", steps=steps, damaged=self._damaged)
        try:
            while self.step < steps and not reason:
                figures = self._one_step()
                reason = self.world.agree(stop.reason(self.seconds), self.batcher.device)
                if self.step == steps or reason or self._due(self.settings.checkpoint_every):
                    self._save()
        except LostProcess as lost:
            self._save()
            message = f"{self.run.path}: lost another process of this run after step {self.step} ({lost})"
            raise TrainingError(f"{message}; a checkpoint is written, --resume goes on") from None
        except InputError:
            # A background that vanished, a detector gone wrong: keep what was reached, unless the disk is the trouble.
            with contextlib.suppress(InputError):
                self._save()
            raise
        reason = reason if self.step < steps else ""
        self._tell("end", outcome="stopped" if reason else "done", reason=reason)
        return figures, reason

    def _recorded_figures(self) -> StepFigures | None:
        """Of the last step in the event log: what a run that was complete before has to tell."""
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
        lr = learning_rate(self.settings, self.step, self.sampler.steps, self.sampler.epoch_of(self.step))
        batch = self.batches.batch(self.step)
        share = len(batch.views) / self.sampler.images_of(self.step)
        step = gradient_step(self.objective, self.optimizer, batch, self.world, share)
        if not step.is_finite:
            self._refuse(step)
        self.optimizer.update(lr)
        self.step += 1
        self._tell("step", **dataclasses.asdict(step.figures), lr=lr)
        if self.world.is_first and self._due(self.settings.preview_every):
            path = self.run.previews / f"step-{self.step:08d}.png"
            save_preview(path, step.images, step.detections[0], self.settings.threshold)
            self._tell("preview", path=f"previews/{path.name}")
        return step.figures

    def _refuse(self, step: Step) -> None:
        names = [
            detector.spec
            for detector, said in zip(self.detectors, step.detections, strict=True)
            if not (torch.isfinite(said.scores).all() and torch.isfinite(said.boxes).all())
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

    def _colors_array(self) -> Float[np.ndarray, "L 3"]:
        return self.optimizer.colors().detach().cpu().numpy().astype(np.float32, copy=True)

    def _save(self) -> None:
        if self.world.is_first:
            write_colors(self.run.colors, self._colors_array())
            save_checkpoint(self.run.checkpoint, Checkpoint(self.step, self.seconds, self.optimizer.state()))
            self._tell("checkpoint")

    def _restore(self) -> list[str]:
        """Load the last sound checkpoint, if any, in every process; returns what was wrong with later ones."""
        checkpoint, damaged = self.world.first_does(lambda: load_checkpoint(self.run.checkpoint)) or (None, [])
        checkpoint = receive_checkpoint(self.world.spread(send_checkpoint(checkpoint)))
        if checkpoint is not None:
            try:
                self.optimizer.load(checkpoint.tensors)
            except (KeyError, ValueError) as error:
                raise InputError(f"{self.run.checkpoint}: holds another run's state ({error})") from None
            self.step, self._earlier = checkpoint.step, checkpoint.time
        if self.world.is_first:
            rewind_events(self.run.events, self.step)
        return damaged


@contextlib.contextmanager
def _threads(count: int | None) -> Iterator[None]:
    before = torch.get_num_threads()
    if count is not None:
        torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
