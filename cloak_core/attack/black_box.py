"""Colours from a detector's answers alone: a random search over patches of faces, bounded by the images asked.

After Square Attack (Andriushchenko et al., ECCV 2020), on a mesh and under changing views: a try changes a patch of
neighbouring faces and is kept where the detectors then find the person less surely in the same images. The images stay
for a round of tries; then come new ones, on which the colours so far are asked first. That first answer is about images
that nothing was fitted to, so that they make an honest curve of success against queries on the training material.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.attack.batches import Batch, Batcher
from cloak_core.attack.checkpoints import Checkpoint, load_checkpoint, save_checkpoint
from cloak_core.attack.events import EventLog, OnEvent, read_events, rewind_events
from cloak_core.attack.loop import RunResult
from cloak_core.attack.objective import Objective, StepFigures
from cloak_core.attack.run_folder import RunFolder
from cloak_core.attack.settings import TrainSettings
from cloak_core.attack.stopping import StopRequest
from cloak_core.exchange.colors import write_colors
from cloak_core.files.errors import InputError

TRIES = 8
"""On the images of a round."""
LAST_BLOCK = 1 / 16
"""Of the first patches' size: that of the last ones."""
_STREAM = 0xB1AC
"""Of random numbers, apart from those that draw the images."""


@dataclasses.dataclass(frozen=True, eq=False)
class SearchResult(RunResult):
    """How a search ended."""

    queries: int = 0
    """Images that the detectors were shown, every detector's counted."""
    curve: tuple[tuple[int, float], ...] = ()
    """Success on each round's new images, before anything was fitted to them, after so many queries."""

    def record(self) -> dict:
        return super().record() | {"queries": self.queries, "curve": [list(point) for point in self.curve]}


def asks(settings: TrainSettings, detectors: int) -> int:
    """How often a batch can be shown to so many detectors. InputError: not even for one try."""
    cost = settings.run.batch * detectors
    count = (settings.queries.black_box_queries or 0) // cost
    if count < 2:
        raise InputError(f"--black-box-queries: fewer than the {2 * cost} that a single try takes (--batch {cost})")
    return count


def search_settings(settings: TrainSettings, detectors: int) -> TrainSettings:
    """The settings by which a search draws its images and judges answers: a batch a round, the margin for its loss."""
    rounds = -(-asks(settings, detectors) // (TRIES + 1))
    changes = {"steps": rounds, "epochs": None, "hard_views": 0.0, "loss": "margin", "rpn_weight": 0.0}
    ensemble = {"ensemble": "mean", "detector_weights": None, "detectors_per_step": None}
    return settings.changed(**changes, **ensemble)


class Search:
    """One search from its last checkpoint (or its start) to its end. A step is one batch shown to every detector."""

    def __init__(
        self,
        settings: TrainSettings,
        run: RunFolder,
        batcher: Batcher,
        objective: Objective,
        start: Float[Tensor, "L 3"],
        centres: Float[np.ndarray, "L 3"],
        on_event: OnEvent | None,
    ) -> None:
        """`batcher` and `objective` are those of `search_settings`; centres: of the logo's faces, metres."""
        self.settings, self.run, self.batcher, self.objective = settings, run, batcher, objective
        self.centres, self.colors, self.step = centres, start.clone(), 0
        self.steps, self.cost = asks(settings, len(objective.detectors)), len(objective.detectors) * settings.run.batch
        self._best, self._earlier, self._started = np.inf, 0.0, time.perf_counter()
        self._batch: tuple[int, Batch] | None = None
        self._restore()
        self.log = EventLog(run.events, on_event)

    def run_to_end(self, stop: StopRequest) -> SearchResult:
        """Asks until done or told to stop; a checkpoint and the colours are written either way."""
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
            queries=self.step * self.cost,
            curve=tuple((event["queries"], event["success"]) for event in told),
        )

    @torch.no_grad()
    def _one_step(self) -> StepFigures:
        """Ask about new images, or about a try on those that are there."""
        number, place = divmod(self.step, TRIES + 1)
        batch = self._images_of(number)
        tried = self.colors if place == 0 else self._changed()
        answer = self.objective.ask(batch.images(tried))
        loss, success = float(answer.disappearance), float(answer.success)
        if not np.isfinite(loss):
            raise InputError(f"{self.run.path}: step {self.step}: a detector's answer is not finite")
        kept = place == 0 or loss < self._best
        if kept:
            self.colors, self._best = tried, loss
        self.step += 1
        restless = float(self.objective.total_variation(self.colors))
        figures = StepFigures(self._best, self._best, restless, 0.0, success)
        asked = {"queries": self.step * self.cost, "success": success}
        if place == 0:
            self._tell("round", **asked, disappearance=loss)
        self._tell("step", **dataclasses.asdict(figures), **{"queries": asked["queries"], "kept": kept})
        return figures

    def _changed(self) -> Float[Tensor, "L 3"]:
        """The colours with a patch of neighbouring faces changed; a function of (seed, step) and the colours."""
        random = np.random.default_rng([self.settings.run.seed, _STREAM, self.step])
        queries, done = self.settings.queries, self.step / self.steps
        count = max(1, round(queries.query_block * LAST_BLOCK**done * len(self.centres)))
        about = self.centres[random.integers(len(self.centres))]
        apart = ((self.centres - about) ** 2).sum(1)
        patch = torch.from_numpy(np.argpartition(apart, count - 1)[:count]).to(self.colors.device)
        if random.random() < 0.5:  # the pattern stays, in another colour
            change = queries.query_change * random.choice([-1.0, 1.0], 3)
            new = self.colors[patch] + torch.from_numpy(change).to(self.colors)
        else:  # towards one colour
            corner = torch.from_numpy(random.integers(0, 2, 3).astype(np.float64)).to(self.colors)
            new = torch.lerp(self.colors[patch], corner.expand(count, 3), queries.query_change)
        return self.colors.index_copy(0, patch, new.clamp(0, 1))

    def _images_of(self, number: int) -> Batch:
        if self._batch is None or self._batch[0] != number:
            self._batch = (number, self.batcher.batch(number))
        return self._batch[1]

    @property
    def seconds(self) -> float:
        return self._earlier + time.perf_counter() - self._started

    def _tell(self, kind: str, **more: object) -> None:
        self.log.write({"type": kind, "step": self.step, "time": round(self.seconds, 4)} | more)

    def _save(self) -> None:
        write_colors(self.run.colors, self.colors.cpu().numpy())
        best = torch.tensor([self._best], dtype=torch.float64)
        tensors = {"parameter": self.colors, "black_box.best": best}
        save_checkpoint(self.run.checkpoint, Checkpoint(self.step, self.seconds, tensors))

    def _restore(self) -> None:
        checkpoint, _ = load_checkpoint(self.run.checkpoint)
        if checkpoint is not None:
            colors, best = (checkpoint.tensors.get(name) for name in ("parameter", "black_box.best"))
            if colors is None or best is None or colors.shape != self.colors.shape or best.shape != (1,):
                raise InputError(f"{self.run.checkpoint}: holds another run's state")
            self.colors, self._best = colors.to(self.colors), float(best)
            self.step, self._earlier = checkpoint.step, checkpoint.time
        rewind_events(self.run.events, self.step)
