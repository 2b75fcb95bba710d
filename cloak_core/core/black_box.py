"""Colours from a detector's answers alone: a gradient estimated from pairs of questions, bounded by the images asked.

Natural evolution strategies (Ilyas et al., ICML 2018) on a mesh and under changing views: each image of a batch is
asked about twice, with the colours moved a little along a direction of its own and against it; the difference of the
two answers weighs the direction. Directions are low-dimensional: the logo falls apart into cells around random faces,
and every cell moves its three channels up or down. With surrogates (`query_prior`) most directions are their gradients
instead. No image is asked about again in a later step, so that nothing is
fitted to single images; now and then the colours themselves are asked first, which makes an honest curve of success
against queries on the training material.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from torch import Tensor

from cloak_core.core.batches import Batch, Batcher
from cloak_core.core.checkpoints import Checkpoint, load_checkpoint, save_checkpoint
from cloak_core.core.events import EventLog, OnEvent, read_events, rewind_events
from cloak_core.core.loop import RunResult
from cloak_core.core.objective import Objective, StepFigures
from cloak_core.core.run_folder import RunFolder
from cloak_core.core.settings import TrainSettings
from cloak_core.core.stopping import StopRequest
from cloak_core.exchange.colors import write_colors
from cloak_core.files.errors import InputError

EVERY = 8
"""Steps from one look at the colours themselves to the next."""
CELLS = (8, 64)
"""Fewest and most cells of a direction; the number is drawn evenly in its logarithm. More cells need more answers than
a few thousand: with up to 512 a search against YOLO-LITE got nowhere."""
PRIOR = 0.75
"""Share of the directions that surrogates give, where there are any; the others keep what surrogates are blind to."""
MEMORY = (0.9, 0.99)
"""Of the estimate, and of its mean square."""
_STREAM = 0xB1AC
"""Of random numbers, apart from those that draw the images."""


@dataclasses.dataclass(frozen=True, eq=False)
class SearchResult(RunResult):
    """How a search ended."""

    queries: int = 0
    """Images that the detectors were shown, every detector's counted."""
    curve: tuple[tuple[int, float], ...] = ()
    """Success of the colours on new images, after so many queries."""

    def record(self) -> dict:
        return super().record() | {"queries": self.queries, "curve": [list(point) for point in self.curve]}


def queries_after(steps: int, cost: int) -> int:
    """Count the images that `steps` steps ask about; `cost`: images of a batch, over all detectors."""
    return cost * (2 * steps + -(-steps // EVERY))


def steps_within(settings: TrainSettings, detectors: int) -> int:
    """Count the steps that the allowed images last. InputError: not even for one."""
    cost, allowed = settings.run.batch * detectors, settings.queries.black_box_queries or 0
    if allowed < queries_after(1, cost):
        raise InputError(
            f"--black-box-queries: fewer than the {queries_after(1, cost)} that one step takes (--batch "
            f"{settings.run.batch})"
        )
    rounds, left = divmod(allowed // cost, 2 * EVERY + 1)
    return rounds * EVERY + max(left - 1, 0) // 2


def search_settings(settings: TrainSettings, detectors: int) -> TrainSettings:
    """Make the settings by which a search draws images and judges answers: a batch a step, the margin as loss."""
    steps = steps_within(settings, detectors)
    changes = {"steps": steps, "epochs": None, "hard_views": 0.0, "loss": "margin", "rpn_weight": 0.0}
    ensemble = {"ensemble": "mean", "detector_weights": None, "detectors_per_step": None}
    return settings.changed(**changes, **ensemble)


class Search:
    """One search from its last checkpoint (or its start) to its end. A step is a batch of pairs of questions."""

    def __init__(
        self,
        settings: TrainSettings,
        run: RunFolder,
        batcher: Batcher,
        objective: Objective,
        start: Float[Tensor, "L 3"],
        centres: Float[np.ndarray, "L 3"],
        on_event: OnEvent | None,
        prior: QueryPrior | None = None,
    ) -> None:
        """Begin a search; `batcher` and `objective` are those of `search_settings`.

        centres: of the logo's faces, metres.
        """
        self.prior = prior
        self.settings, self.run, self.batcher, self.objective = settings, run, batcher, objective
        self.centres, self.colors, self.step = centres, start.clone(), 0
        self.cost = len(objective.detectors) * settings.run.batch
        self.steps = steps_within(settings, len(objective.detectors))
        self._mean, self._square = torch.zeros_like(start), start.new_zeros(())
        self._earlier, self._started = 0.0, time.perf_counter()
        self._restore()
        self.log = EventLog(run.events, on_event)

    def run_to_end(self, stop: StopRequest) -> SearchResult:
        """Ask until done or told to stop; a checkpoint and the colours are written either way."""
        figures, reason = None, ""
        try:
            self._tell("resume" if self.step else "start", steps=self.steps)
            while self.step < self.steps and not reason:
                figures = self._one_step()
                every = self.settings.run.checkpoint_every
                reason = stop.reason(self.seconds)
                kept = self.settings.run.snapshot_every
                if kept and self.step % kept == 0:
                    self.run.write_snapshot(self.step, self.colors.cpu().numpy())
                if every and self.step % every == 0:
                    self._save()
            reason = "" if self.step >= self.steps else reason
            self._tell("end", outcome="stopped" if reason else "done", reason=reason, colors_step=self.step)
        finally:
            with contextlib.suppress(InputError):
                self._save()
            self.log.close()
        told = [event for event in read_events(self.run.events) if event.get("type") == "round"]
        return SearchResult(
            out=self.run.path,
            step=self.step,
            steps=self.steps,
            seconds=self.seconds,
            figures=figures,
            stopped=reason,
            colors=self.colors.cpu().numpy().astype(np.float32),
            colors_step=self.step,
            queries=queries_after(self.step, self.cost),
            curve=tuple((event["queries"], event["success"]) for event in told),
        )

    @torch.no_grad()
    def _one_step(self) -> StepFigures:
        """Ask about new images to either side of the colours, and follow the difference."""
        batch = self.batcher.batch(self.step)
        if self.step % EVERY == 0:
            self._look(batch)
        moves = self._directions(batch) * self.settings.queries.query_change
        losses, successes = zip(
            *(self._asked(batch, (self.colors + side * moves).clamp(0, 1)) for side in (1, -1)), strict=True
        )
        self._follow(((losses[0] - losses[1])[:, None, None] * moves).mean(0))
        self.step += 1
        loss, success = float(torch.cat(losses).mean()), sum(successes) / 2
        figures = StepFigures(loss, loss, float(self.objective.total_variation(self.colors)), 0.0, success)
        self._tell("step", **dataclasses.asdict(figures), queries=queries_after(self.step, self.cost))
        return figures

    def _asked(self, batch: Batch, colors: Float[Tensor, "*B L 3"]) -> tuple[Float[Tensor, " B"], float]:
        """Ask the detectors: each image's loss, mean over the detectors, and the success."""
        answer = self.objective.forward_backward(batch.images(colors), bodies=batch.bodies)
        said = answer.detections.items()
        losses = torch.stack([self.objective.loss(detections, number) for number, detections in said]).mean(0)
        if not torch.isfinite(losses).all():
            raise InputError(f"{self.run.path}: step {self.step}: a detector's answer is not finite")
        return losses, float(answer.success)

    def _look(self, batch: Batch) -> None:
        losses, success = self._asked(batch, self.colors)
        asked = queries_after(self.step, self.cost) + self.cost
        self._tell("round", queries=asked, success=success, disappearance=float(losses.mean()))

    def _directions(self, batch: Batch) -> Float[Tensor, "B L 3"]:
        """Draw -1, 0 or 1 for every face and channel, alike within a cell; by (seed, step) and the colours."""
        random = np.random.default_rng([self.settings.run.seed, _STREAM, self.step])
        found = torch.from_numpy(self._random_directions(len(batch), random)).to(self.colors)
        if self.prior is None:
            return found
        led = torch.from_numpy(random.random(len(batch)) < PRIOR).to(found.device)
        return torch.where(led[:, None, None], self.prior.directions(batch, self.colors, self.step, random), found)

    def _random_directions(self, count: int, random: np.random.Generator) -> Float[np.ndarray, "B L 3"]:
        found = np.empty((count, len(self.centres), 3), np.float32)
        for direction in found:
            cell = random_cells(self.centres, CELLS, random)
            direction[:] = random.choice(np.float32([-1, 1]), (int(cell.max()) + 1, 3))[cell]
        return found

    def _follow(self, estimate: Float[Tensor, "L 3"]) -> None:
        """Take one step of Adam with a single scale for all colours: short where answers contradict each other."""
        first, second = MEMORY
        self._mean.lerp_(estimate, 1 - first)
        self._square.lerp_(estimate.square().mean(), 1 - second)
        done = self.step + 1
        scale = (self._square / (1 - second**done)).sqrt().clamp_min(torch.finfo(estimate.dtype).tiny)
        move = self.settings.queries.query_lr * self._mean / (1 - first**done) / scale
        self.colors = (self.colors - move).clamp(0, 1)

    @property
    def seconds(self) -> float:
        return self._earlier + time.perf_counter() - self._started

    def _tell(self, kind: str, **more: object) -> None:
        self.log.write({"type": kind, "step": self.step, "time": round(self.seconds, 4)} | more)

    def _save(self) -> None:
        write_colors(self.run.colors, self.colors.cpu().numpy())
        tensors = {"parameter": self.colors, "black_box.mean": self._mean, "black_box.square": self._square}
        save_checkpoint(self.run.checkpoint, Checkpoint(self.step, self.seconds, tensors))

    def _restore(self) -> None:
        checkpoint, _ = load_checkpoint(self.run.checkpoint)
        if checkpoint is not None:
            names = ("parameter", "black_box.mean", "black_box.square")
            kept = [checkpoint.tensors.get(name) for name in names]
            own = (self.colors, self._mean, self._square)
            if any(tensor is None or tensor.shape != mine.shape for tensor, mine in zip(kept, own, strict=True)):
                raise InputError(f"{self.run.checkpoint}: holds another run's state")
            self.colors, self._mean, self._square = (tensor.to(self.colors, copy=True) for tensor in kept)
            self.step, self._earlier = checkpoint.step, checkpoint.time
        rewind_events(self.run.events, self.step)


PRIOR_CELLS = (64, 1024)
"""Fewest and most cells over which a gradient is averaged: single faces' gradients are mostly of this one image."""


def random_cells(
    centres: Float[np.ndarray, "L 3"], bounds: tuple[int, int], random: np.random.Generator
) -> Int[np.ndarray, " L"]:
    """Divide the faces into cells around random faces: the number of each face's cell, from 0.

    Their number lies within `bounds`, drawn evenly in its logarithm.
    """
    low, high = np.log(np.minimum(bounds, len(centres)))
    count = round(np.exp(random.uniform(low, high)))
    about = centres[random.choice(len(centres), count, replace=False)]
    return cKDTree(about).query(centres)[1]


class QueryPrior:
    """Directions from surrogates' gradients. InputError: a surrogate gives none.

    The subspace attack (Yan, Guo and Zhang, NeurIPS 2019): random directions in thousands of colours hardly ever matter
    to a detector; gradients of surrogates, shaken anew each time, span a space in which many of them do. The asked
    detector's answers decide alone which of them is followed, and to which side.
    """

    def __init__(self, objective: Objective, centres: Float[np.ndarray, "L 3"]) -> None:
        """Take the `objective` of the surrogates, the margin as its loss; centres: of the logo's faces, metres."""
        for detector in objective.detectors:
            if not detector.differentiable:
                raise InputError(f"--query-prior {detector.spec}: gives no gradients")
        self.objective, self.centres = objective, centres

    def directions(
        self, batch: Batch, colors: Float[Tensor, "L 3"], step: int, random: np.random.Generator
    ) -> Float[Tensor, "B L 3"]:
        """Give -1, 0 or 1 for every face and channel of each image: the sign of one surrogate's gradient.

        Averaged within cells; 0 where the image does not show the cell.
        """
        count = len(self.objective.detectors)
        gradient = self._gradient(batch, colors, step, random.integers(count, size=len(batch)))
        found = torch.empty_like(gradient)
        for row, one in zip(found, gradient, strict=True):
            cell = torch.from_numpy(random_cells(self.centres, PRIOR_CELLS, random)).to(one.device)
            sums = torch.zeros_like(one[: int(cell.max()) + 1])
            row.copy_(sums.index_add_(0, cell, one).sign()[cell])
        return found

    def _gradient(
        self, batch: Batch, colors: Float[Tensor, "L 3"], step: int, chosen: Int[np.ndarray, " B"]
    ) -> Float[Tensor, "B L 3"]:
        """Compute each image's gradient of its chosen surrogate's loss, by the colours in that image."""
        with torch.enable_grad():
            moved = colors.expand(len(batch), -1, -1).clone().requires_grad_()
            images, total = batch.images(moved), 0.0
            for number in np.unique(chosen).tolist():
                rows = torch.from_numpy(np.flatnonzero(chosen == number)).to(images.device)
                said = self.objective.detect(number, images[rows], step, batch.bodies[rows])
                total = total + self.objective.loss(said, number).sum()
            (gradient,) = torch.autograd.grad(total, moved)
        return gradient
