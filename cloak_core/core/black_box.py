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

import dataclasses

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from torch import Tensor

from cloak_core.core.batches import Batch, Batcher
from cloak_core.core.events import OnEvent, read_events
from cloak_core.core.loop import StopRequest
from cloak_core.core.objective import Objective, Step, StepFigures
from cloak_core.core.optimizer import ColorOptimizer
from cloak_core.core.run_folder import RunFolder
from cloak_core.core.settings import TrainSettings
from cloak_core.core.settings.components import OptimizerSettings
from cloak_core.core.training import RunResult, TrainingLoop
from cloak_core.core.world import World
from cloak_core.files.errors import InputError

QUERY_CHANGE = 0.1
"""How far a query moves the colours to either side, in units of colour."""
EVERY = 8
"""Steps from one look at the colours themselves to the next."""
CELLS = (8, 64)
"""Fewest and most cells of a direction; the number is drawn evenly in its logarithm. More cells need more answers than
a few thousand: with up to 512 a search against YOLO-LITE got nowhere."""
PRIOR = 0.75
"""Share of the directions that surrogates give, where there are any; the others keep what surrogates are blind to."""
MEMORY = (0.9, 0.99)
"""Of the estimate, and of its mean square."""
QUERY_LR = 0.02
"""How far the colours follow the estimated gradient in each update, in units of colour [0, 1]."""
_STREAM = 0xB1AC
"""Of random numbers, apart from those that draw the images."""


@dataclasses.dataclass(frozen=True, eq=False)
class SearchResult(RunResult):
    """How a search ended."""

    queries: int = 0
    """Images that the detectors were shown, every detector's counted."""
    curve: tuple[tuple[int, float], ...] = ()
    """Success of the colours on new images, by the number of queries before."""

    def record(self) -> dict:
        return super().record() | {"queries": self.queries, "curve": [list(point) for point in self.curve]}


def queries_after(steps: int, cost: int) -> int:
    """Count the images that `steps` steps ask about; `cost`: images of a batch, over all detectors."""
    return cost * (2 * steps + -(-steps // EVERY))


def steps_within(settings: TrainSettings, detectors: int) -> int:
    """Count the steps that the allowed images last. InputError: not even for one."""
    cost = settings.run.batch * detectors
    allowed = settings.queries.black_box_queries or 0
    if allowed < queries_after(1, cost):
        raise InputError(
            f"--black-box-queries: fewer than the {queries_after(1, cost)} that one step takes (--batch "
            f"{settings.run.batch})"
        )
    rounds, left = divmod(allowed // cost, 2 * EVERY + 1)
    return rounds * EVERY + max(left - 1, 0) // 2


def search_settings(settings: TrainSettings, detectors: int) -> TrainSettings:
    """Make the settings by which a search draws images, judges answers and moves: the margin as loss, its own rate."""
    return settings.changed(
        steps=steps_within(settings, detectors),
        epochs=None,
        loss="margin",
        ensemble="mean",
        detectors_per_step=None,
        lr=QUERY_LR,
        schedule="constant",
        gamut="projection",
    )


class QueryOptimizer(ColorOptimizer):
    """Colours that follow an estimated gradient: Adam with a single scale for all of them.

    A step is short where answers contradict each other.
    """

    def __init__(self, settings: OptimizerSettings, initial: Float[Tensor, "L 3"]) -> None:
        super().__init__(settings, initial)
        self._step = 0
        self._mean = torch.zeros_like(initial)
        self._square = initial.new_zeros(())

    def on_step(self, step: int, steps: int) -> None:
        self._step = step

    def follow(self, estimate: Float[Tensor, "L 3"]) -> None:
        """Take this for the gradient, until the next `update`."""
        self._parameter.grad = estimate

    @torch.no_grad()
    def update(self, lr: float) -> None:
        estimate = self._parameter.grad
        first, second = MEMORY
        self._mean.lerp_(estimate, 1 - first)
        self._square.lerp_(estimate.square().mean(), 1 - second)
        done = self._step + 1
        scale = (self._square / (1 - second**done)).sqrt().clamp_min(torch.finfo(estimate.dtype).tiny)
        self._parameter.sub_(lr * self._mean / (1 - first**done) / scale).clamp_(0, 1)

    def state(self) -> dict[str, Tensor]:
        return {
            "parameter": self._parameter.detach(),
            "black_box.mean": self._mean,
            "black_box.square": self._square,
        }

    def load(self, tensors: dict[str, Tensor]) -> None:
        own = self.state()
        for name, tensor in own.items():
            if tensors[name].shape != tensor.shape:
                raise ValueError(f"{name} has the shape {list(tensors[name].shape)} instead of {list(tensor.shape)}")
        for name, tensor in own.items():
            tensor.copy_(tensors[name])


class Search(TrainingLoop):
    """A training whose gradient is estimated from answers: a step is a batch of pairs of questions."""

    def __init__(
        self,
        settings: TrainSettings,
        run: RunFolder,
        batcher: Batcher,
        objective: Objective,
        start: Float[Tensor, "L 3"],
        on_event: OnEvent | None,
        world: World,
        centres: Float[np.ndarray, "L 3"],
        prior: QueryPrior | None = None,
    ) -> None:
        """Begin a search; `settings` (those of `search_settings`) made `batcher` and `objective`.

        centres: of the logo's faces, metres.
        """
        self.centres = centres
        self.prior = prior
        self.cost = len(objective.detectors) * settings.run.batch
        optimizer = QueryOptimizer(settings.optimization, start)
        super().__init__(settings, run, batcher, objective, optimizer, on_event, world)

    def run_to_end(self, stop: StopRequest) -> SearchResult:
        """Ask until done or told to stop; a checkpoint and the colours are written either way."""
        result = super().run_to_end(stop)
        rounds = [event for event in read_events(self.folder.events) if event.get("type") == "round"]
        curve = tuple((event["queries"], event["success"]) for event in rounds)
        return SearchResult(**vars(result), queries=queries_after(self.step, self.cost), curve=curve)

    @torch.no_grad()
    def _gradient(self, batch: Batch, part: float) -> Step:
        """Ask about new images to either side of the colours; the difference is the gradient."""
        colors = self.optimizer.finished()
        if self.step % EVERY == 0:  # ask about the colours themselves, before images of this batch decide anything
            _, step = self._ask(batch, colors)
            asked = queries_after(self.step, self.cost) + self.cost
            # It belongs to the step that begins: a run that goes on from the checkpoint before it measures again.
            facts = {"step": self.step + 1, "success": step.figures.success, "disappearance": step.figures.loss}
            self.tell("round", queries=asked, **facts)
        moves = self._directions(batch, colors) * QUERY_CHANGE
        ahead, step_ahead = self._ask(batch, (colors + moves).clamp(0, 1))
        behind, step_behind = self._ask(batch, (colors - moves).clamp(0, 1))
        self.optimizer.follow(((ahead - behind)[:, None, None] * moves).mean(0))
        loss = float(torch.cat([ahead, behind]).mean())
        success = (step_ahead.figures.success + step_behind.figures.success) / 2
        figures = dataclasses.replace(step_ahead.figures, loss=loss, disappearance=loss, success=success)
        return dataclasses.replace(step_ahead, figures=figures)

    def _facts(self, lr: float) -> dict[str, object]:
        return super()._facts(lr) | {"queries": queries_after(self.step, self.cost)}

    def _ask(self, batch: Batch, colors: Float[Tensor, "*B L 3"]) -> tuple[Float[Tensor, " B"], Step]:
        """Ask the detectors: each image's loss, mean over the detectors, and what they said of all.

        TrainingError: a loss is not finite.
        """
        images = batch.images(colors)
        answer = self.objective.forward_backward(images, bodies=batch.bodies, company=batch.company)
        detections = answer.detections
        losses = torch.stack([self.objective.loss(detections[number], number) for number in detections]).mean(0)
        loss = float(losses.mean())
        variation = float(self.objective.total_variation(self.optimizer.finished()))
        figures = StepFigures(loss, loss, variation, {}, float(answer.success))
        step = Step(figures, bool(torch.isfinite(losses).all()), images, detections)
        if not step.is_finite:
            self._refuse(step)
        return losses, step

    def _directions(self, batch: Batch, colors: Float[Tensor, "L 3"]) -> Float[Tensor, "B L 3"]:
        """Draw -1, 0 or 1 for every face and channel, alike within a cell; by (seed, step) and the colours."""
        random = np.random.default_rng([self.settings.run.seed, _STREAM, self.step])
        directions = np.empty((len(batch), len(self.centres), 3), np.float32)
        for direction in directions:
            cell = random_cells(self.centres, CELLS, random)
            direction[:] = random.choice(np.float32([-1, 1]), (int(cell.max()) + 1, 3))[cell]
        directions = torch.from_numpy(directions).to(colors)
        if self.prior is None:
            return directions
        is_led = torch.from_numpy(random.random(len(batch)) < PRIOR).to(directions.device)
        return torch.where(is_led[:, None, None], self.prior.directions(batch, colors, self.step, random), directions)


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
        self.objective = objective
        self.centres = centres

    def directions(
        self, batch: Batch, colors: Float[Tensor, "L 3"], step: int, random: np.random.Generator
    ) -> Float[Tensor, "B L 3"]:
        """Give -1, 0 or 1 for every face and channel of each image: the sign of one surrogate's gradient.

        Averaged within cells; 0 where the image does not show the cell.
        """
        count = len(self.objective.detectors)
        gradient = self._gradient(batch, colors, step, random.integers(count, size=len(batch)))
        directions = torch.empty_like(gradient)
        for direction, of_image in zip(directions, gradient, strict=True):
            cell = torch.from_numpy(random_cells(self.centres, PRIOR_CELLS, random)).to(of_image.device)
            sums = torch.zeros_like(of_image[: int(cell.max()) + 1])
            direction.copy_(sums.index_add_(0, cell, of_image).sign()[cell])
        return directions

    def _gradient(
        self, batch: Batch, colors: Float[Tensor, "L 3"], step: int, chosen: Int[np.ndarray, " B"]
    ) -> Float[Tensor, "B L 3"]:
        """Compute each image's gradient of its chosen surrogate's loss, by the colours in that image."""
        with torch.enable_grad():
            moved = colors.expand(len(batch), -1, -1).clone().requires_grad_()
            images = batch.images(moved)
            total = 0.0
            for number in np.unique(chosen).tolist():
                rows = torch.from_numpy(np.flatnonzero(chosen == number)).to(images.device)
                among = None if batch.company is None else batch.company.part(rows)
                detections = self.objective.detect(number, images[rows], step, batch.bodies[rows], among)
                total = total + self.objective.loss(detections, number).sum()
            (gradient,) = torch.autograd.grad(total, moved)
        return gradient
