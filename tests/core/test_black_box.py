"""The search with answers alone: bounded, better than where it began, resumable to the same colours."""

import numpy as np
import pytest
import torch

from cloak_core.core import black_box
from cloak_core.core.batches import Batch, Company
from cloak_core.core.black_box import EVERY, QueryPrior, queries_after, steps_within
from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.events import read_events
from cloak_core.files.errors import InputError
from tests.core.fakes import Says, TinyDetector, tiny_settings
from tests.core.test_ensemble import objective
from tests.core.test_training import run


class Asked(Detector):
    """Gives no gradient, counts the images it is shown, and finds a person in what is redder than blue."""

    differentiable = False

    def __init__(self) -> None:
        super().__init__("asked", "asked")
        self.images = 0

    def forward(self, images: torch.Tensor) -> Detections:
        assert not images.requires_grad
        self.images += len(images)
        scores = torch.sigmoid(40 * (images[:, :1] - images[:, 2:]).mean((2, 3)))
        return Detections(scores.new_zeros(*scores.shape, 4), scores)


@pytest.fixture
def quick(monkeypatch):
    """Few questions move the colours far."""
    monkeypatch.setattr(black_box, "QUERY_LR", 0.1)


HOW = {"batch": 4, "steps": None, "epochs": 1, "noise": 0.0, "preview_every": 0, "checkpoint_every": 0}


@pytest.mark.slow
def test_a_search_lowers_the_score_with_no_more_images_than_allowed(tmp_path, quick):
    detector = Asked()
    result = run(tmp_path / "run", [detector], black_box_queries=203, angles="0", translation=0, **HOW)
    assert detector.images == result.queries == queries_after(result.step, 4) <= 203 < queries_after(result.step + 1, 4)
    rounds = [event for event in read_events(tmp_path / "run" / "events.jsonl") if event["type"] == "round"]
    assert len(rounds) == len(result.curve) == -(-result.step // EVERY)
    assert rounds[-1]["disappearance"] < rounds[0]["disappearance"] - 0.1
    red, blue = result.colors[:, 0].mean(), result.colors[:, 2].mean()
    assert blue > red and result.colors.min() >= 0 and result.colors.max() <= 1
    assert result.record()["queries"] == detector.images and len(result.record()["curve"]) == len(rounds)


@pytest.mark.parametrize("allowed", [12, 19, 20, 67, 68, 71, 76, 80, 2000])
def test_as_many_steps_as_the_images_last(allowed):
    steps = steps_within(tiny_settings(black_box_queries=allowed, batch=4), 1)
    assert queries_after(steps, 4) <= allowed < queries_after(steps + 1, 4)


@pytest.mark.slow
def test_a_stopped_search_goes_on_to_the_same_colours(tmp_path):
    whole = run(tmp_path / "whole", [Asked()], black_box_queries=140, snapshot_every=5, **HOW)
    kept = sorted(path.name for path in (tmp_path / "whole" / "snapshots").iterdir())
    assert kept == ["step-00000005.npy", "step-00000010.npy", "step-00000015.npy"]
    stop = lambda event: (tmp_path / "part" / "cancel").touch() if event["step"] == 13 else None
    part = run(tmp_path / "part", [Asked()], on_event=stop, black_box_queries=140, **HOW)
    assert part.stopped == "cancel file" and part.step < part.steps
    rest = run(tmp_path / "part", [Asked()], resume=True, black_box_queries=140, **HOW)
    assert np.array_equal(whole.colors, rest.colors) and whole.curve == rest.curve
    with pytest.raises(InputError, match="black_box_queries"):
        run(tmp_path / "part", [Asked()], resume=True, black_box_queries=160, **HOW)


@pytest.mark.slow
def test_every_detectors_images_count_and_a_start_is_taken(tmp_path):
    first = run(tmp_path / "first", [TinyDetector()], steps=1, preview_every=0)
    result = run(tmp_path / "run", [Asked(), TinyDetector()], black_box_queries=24, init=str(tmp_path / "first"), **HOW)
    assert result.queries == 24 and result.steps == 1
    assert 0 < np.abs(result.colors - first.colors).max() <= 0.1  # a single step from there
    with pytest.raises(InputError, match="fewer than the 24"):
        steps_within(tiny_settings(black_box_queries=23, batch=4), 2)


def blue(sign: float = 1.0) -> Says:
    """A surrogate of `Asked` with a gradient, and blind to all but colour."""
    redness = lambda images: (images[:, 0] - images[:, 2]).mean((1, 2))
    return Says(lambda images: torch.sigmoid(sign * 4 * redness(images)), name=f"blue {sign}")


SHORT = HOW | {"black_box_queries": 68, "angles": "0", "translation": 0}


def _loss_reached(path, **more):
    run(path, [Asked()], **SHORT, **more)
    events = [event for event in read_events(path / "events.jsonl") if event["type"] == "step"]
    return np.mean([event["disappearance"] for event in events[-3:]])


@pytest.mark.slow
def test_surrogates_lead_a_search_even_where_they_are_wrong_about_the_side(tmp_path, quick):
    alone = _loss_reached(tmp_path / "alone")
    led = _loss_reached(tmp_path / "led", query_prior=[blue()])
    contrary = _loss_reached(tmp_path / "contrary", query_prior=[blue(-1)])
    assert led < alone - 0.02 and contrary < alone - 0.02
    with pytest.raises(InputError, match="query_prior"):
        run(tmp_path / "led", [Asked()], resume=True, query_prior=[blue(2)], **SHORT)


class Halves(Detector):
    """Reports somebody in either half of an image, as bright as the half is."""

    def forward(self, images: torch.Tensor) -> Detections:
        side = images.shape[-1] / 2
        boxes = images.new_tensor([[0, 0, side, 2], [side, 0, 2 * side, 2]]).expand(len(images), 2, 4)
        return Detections(boxes, images.mean((1, 2)).sigmoid())


class TwoPeople(Batch):
    """Two images of two pixels of their own colour each; who stands on the right is somebody else."""

    bodies = torch.tensor([[0.0, 0, 1, 2]]).expand(2, 4)
    company = Company(torch.tensor([[[1.0, 0, 2, 2]]]).expand(2, 1, 4), torch.zeros(2, dtype=torch.bool))

    def __len__(self) -> int:
        return 2

    def images(self, colors: torch.Tensor) -> torch.Tensor:
        return colors.transpose(1, 2).unsqueeze(2).expand(-1, -1, 2, -1)


def test_other_people_of_a_photograph_lead_no_search() -> None:
    prior = QueryPrior(objective([Halves("halves", "halves")], loss="margin"), np.float32([[0, 0, 0], [1, 0, 0]]))
    found = prior.directions(
        TwoPeople.__new__(TwoPeople), torch.tensor([[0.2] * 3, [0.9] * 3]), 0, np.random.default_rng(0)
    )
    assert found[:, 0].all() and not found[:, 1].any()


@pytest.mark.slow
def test_a_prior_gives_gradients_and_leads_a_search_alone(tmp_path, quick):
    with pytest.raises(InputError, match="--query-prior asked: gives no gradients"):
        run(tmp_path / "a", [Asked()], black_box_queries=68, query_prior=[Asked()], **HOW)
    with pytest.raises(InputError, match="only leads a search"):
        run(tmp_path / "b", [TinyDetector()], query_prior=[blue()], **HOW)
