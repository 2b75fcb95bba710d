"""Several detectors in one loss, in parts of a batch."""

import numpy as np
import pytest
import torch

from cloak_core.core.detector.protocol import Detections
from cloak_core.core.ensemble import Ensemble, sureness
from cloak_core.core.losses import person_loss
from cloak_core.core.objective import Objective
from cloak_core.patterns.faces import FacePattern
from tests.core.fakes import RenamingDetector, TinyDetector, box_bodies, front_logo, tiny_settings
from tests.core.test_training import run

IMAGES = torch.rand(5, 3, 64, 64, generator=torch.Generator().manual_seed(0))


class Counting(TinyDetector):
    """Counts the images it is shown at a time."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed)
        self.shown: list[int] = []

    def forward(self, images: torch.Tensor) -> Detections:
        self.shown.append(len(images))
        return super().forward(images)


def objective(detectors, **changes) -> Objective:
    """Of the plain score, unless told."""
    pattern = FacePattern(front_logo(box_bodies()))
    return Objective(tiny_settings(**{"loss": "score"} | changes), pattern, detectors, torch.device("cpu"))


def by_hand(detectors) -> tuple[torch.Tensor, torch.Tensor]:
    """Loss and gradient of the whole batch at once."""
    images = IMAGES.clone().requires_grad_()
    loss = torch.stack([person_loss(detector(images)) for detector in detectors]).mean()
    return loss.detach(), torch.autograd.grad(loss, images)[0]


@pytest.mark.slow
@pytest.mark.parametrize("microbatch", [None, 1, 2, 5, 7])
def test_loss_and_gradient_of_an_ensemble(microbatch):
    detectors = [TinyDetector(seed) for seed in range(3)]
    answer = objective(detectors, microbatch=microbatch).forward_backward(IMAGES)
    loss, gradient = by_hand(detectors)
    torch.testing.assert_close(answer.disappearance, loss)
    torch.testing.assert_close(answer.gradient, gradient, rtol=1e-5, atol=1e-9)
    for number, detector in enumerate(detectors):
        torch.testing.assert_close(answer.detections[number].scores, detector(IMAGES).scores)


def test_each_detector_has_the_margin_of_its_own_operating_point():
    detectors = [TinyDetector(seed) for seed in range(2)]
    for detector, point in zip(detectors, (0.25, 0.65), strict=True):
        detector.operating_point = point
    answer = objective(detectors, loss="margin").forward_backward(IMAGES)
    # Of the second, the run's own threshold lies lower.
    each = [person_loss(d(IMAGES), "margin", operating_point=p) for d, p in zip(detectors, (0.25, 0.6), strict=True)]
    torch.testing.assert_close(answer.disappearance, torch.stack(each).mean())
    assert (each[0] > each[1]).sum() + (each[1] > each[0]).sum() == len(IMAGES)


def test_hiding_everything_counts_any_class_on_the_body():
    detector, bodies = RenamingDetector(), torch.tensor([[8.0, 8.0, 40.0, 56.0]]).expand(len(IMAGES), 4)
    for loss in ("score", "log", "margin"):
        asked = objective([detector], loss=loss, hide="everything", microbatch=2)
        answer = asked.forward_backward(IMAGES, bodies=bodies)
        images = IMAGES.clone().requires_grad_()
        found = detector(images)
        inside = (found.boxes[..., 0] >= 8) & (found.boxes[..., 2] <= 40)
        inside &= (found.boxes[..., 1] >= 8) & (found.boxes[..., 3] <= 56)
        best = torch.maximum(found.scores, torch.where(inside, found.other, 0.0))
        expected = person_loss(Detections(found.boxes, best), loss, operating_point=0.5).mean()
        (gradient,) = torch.autograd.grad(expected, images)
        torch.testing.assert_close(answer.disappearance, expected.detach())
        torch.testing.assert_close(answer.gradient, gradient, rtol=1e-5, atol=1e-9)
    with pytest.raises(ValueError, match="box must be known"):
        objective([detector], hide="everything").forward_backward(IMAGES)


@pytest.mark.long
@pytest.mark.parametrize("how", [{}, {"black_box_queries": 600, "microbatch": 3}])
def test_hiding_the_person_alone_renames_it_and_hiding_everything_does_not(tmp_path, how):
    """Of a detector that takes blue for dogs: hidden from all classes it is neither red nor blue."""
    seen = {}
    for hide in ("person", "everything"):
        colors = run(tmp_path / hide, [RenamingDetector()], hide=hide, steps=40, lr=0.05, tv_weight=0, **how).colors
        seen[hide] = float((colors[:, 2] - colors[:, 0]).mean())
    assert seen["person"] > 0.2 > 3 * abs(seen["everything"])


@pytest.mark.slow
def test_microbatches_bound_what_a_detector_is_shown(tmp_path):
    whole, parts = Counting(), Counting()
    a, b = run(tmp_path / "a", [whole], batch=5), run(tmp_path / "b", [parts], batch=5, microbatch=2)
    assert set(whole.shown) == {5} and parts.shown == [2, 2, 1] * 6
    np.testing.assert_allclose(a.colors, b.colors, atol=1e-5)
    assert not np.array_equal(a.colors, np.full_like(a.colors, 0.5))


@pytest.mark.slow
def test_a_subset_per_step_is_drawn_from_seed_and_step(tmp_path):
    detectors = [Counting(seed) for seed in range(4)]
    chosen = {"detectors_per_step": 2, "steps": 8, "checkpoint_every": 3}
    settings = tiny_settings(**chosen).objective
    draws = lambda seed: [tuple(Ensemble(settings, 4, seed).asked(step)) for step in range(200)]
    drawn = draws(0)
    assert all(len(set(numbers)) == 2 for numbers in drawn) and len(set(drawn)) == 6
    assert drawn == draws(0) and drawn != draws(1)

    whole = run(tmp_path / "whole", detectors, **chosen)
    assert [len(detector.shown) for detector in detectors] == [sum(n in a for a in drawn[:8]) for n in range(4)]
    stop = lambda event: event["type"] == "step" and event["step"] == 4 and (tmp_path / "part" / "cancel").touch()
    assert run(tmp_path / "part", detectors, on_event=stop, **chosen).step == 4
    assert np.array_equal(run(tmp_path / "part", detectors, resume=True, **chosen).colors, whole.colors)


def test_subsets_stand_for_the_whole_ensemble():
    detectors = [TinyDetector(seed) for seed in range(3)]
    full = objective(detectors).forward_backward(IMAGES)
    part = objective(detectors, detectors_per_step=2)
    first = {tuple(part.ensemble.asked(step)): step for step in range(100)}
    assert len(first) == 3
    mean = torch.stack([part.forward_backward(IMAGES, step).gradient for step in first.values()]).mean(dim=0)
    torch.testing.assert_close(mean, full.gradient, rtol=1e-4, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("changes", [
    {"ensemble": "adaptive", "shake": 0.3, "cutout": 0.5, "crop": 0.2, "pad": 0.2, "blur": 1.0, "optimizer": "mi",
     "momentum": 0.5, "smooth": 2},
    {"octaves": 3, "gamut": "sigmoid", "initial": "balls", "initial_share": 0.5},
])  # fmt: skip
def test_runs_with_every_technique_resume_to_the_same_bits(tmp_path, changes):
    changes |= {"preview_every": 0}
    detectors = [TinyDetector(0), TinyDetector(1, bias=2.0)]
    whole = run(tmp_path / "whole", detectors, snapshot_every=3, **changes)
    kept = [np.load(tmp_path / "whole" / "snapshots" / f"step-{step:08d}.npy") for step in (3, 6)]
    assert np.array_equal(kept[1], whole.colors) and not np.array_equal(*kept)
    stop = lambda event: (tmp_path / "part" / "cancel").touch() if event["step"] == 3 else None
    part = run(tmp_path / "part", detectors, on_event=stop, **changes)
    assert part.stopped
    rest = run(tmp_path / "part", detectors, resume=True, **changes)
    assert np.array_equal(whole.colors, rest.colors)
    assert not np.array_equal(whole.colors, run(tmp_path / "plain", detectors, preview_every=0).colors)


def adaptive(count: int, **changes: object) -> Ensemble:
    return Ensemble(tiny_settings(ensemble="adaptive", **changes).objective, count)


def test_a_person_is_half_sure_at_the_operating_point():
    scores = torch.tensor([0.0, 0.25, 0.6, 1.0])
    assert sureness(scores, 0.25).tolist() == pytest.approx([0, 0.5, 9 / 11, 1])
    assert sureness(scores, 0.6).tolist() == pytest.approx([0, 2 / 11, 0.5, 1])


def test_an_adaptive_ensemble_weighs_most_what_still_sees():
    ensemble, other = adaptive(3), adaptive(3)
    assert ensemble.weights.tolist() == pytest.approx([1 / 3] * 3)
    for _ in range(60):
        ensemble.observe({0: 0.0, 1: 0.2, 2: 1.0})
    assert ensemble.weights.sum() == pytest.approx(1)
    assert ensemble.weights[2] > 0.9 and ensemble.weights[1] > ensemble.weights[0] > 0
    assert ensemble.weight(2, asked=3) == pytest.approx(ensemble.weights[2])
    other.load(ensemble.state())
    assert np.array_equal(other.weights, ensemble.weights)
    with pytest.raises(ValueError, match="other detectors"):
        adaptive(2).load(ensemble.state())
