"""The loss is never blind: a step against the gradient lowers the score, whatever the score is."""

from pathlib import Path

import pytest
import torch

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import max_person_score
from cloak_core.detectors.loading import load_detector
from tests.detectors.helpers import images, write_tiny


def lowers_score(detector: Detector, batch: torch.Tensor, step: float = 0.02) -> tuple[torch.Tensor, torch.Tensor]:
    """Scores before and after one small step of every image against its gradient."""
    batch = batch.clone().requires_grad_()
    before = max_person_score(detector(batch))
    (gradient,) = torch.autograd.grad(before.sum(), batch)
    assert bool(gradient.isfinite().all()) and bool((gradient.abs().amax(dim=(1, 2, 3)) > 0).all())
    norm = gradient.flatten(1).norm(dim=1)[:, None, None, None]
    for _ in range(8):  # halve until the linear model holds
        with torch.no_grad():
            after = max_person_score(detector(batch - step * gradient / norm))
        if bool((after < before).all()):
            break
        step /= 2
    return before.detach(), after


@pytest.mark.parametrize("bias", [4.0, 0.0, -4.0, -12.0])
def test_darknet_gradient_at_every_score(bias: float, tmp_path: Path) -> None:
    detector = load_detector(write_tiny(tmp_path))
    last = detector.network.layers[3].conv
    with torch.no_grad():
        last.bias.view(2, 6)[:, 4] += bias
    before, after = lowers_score(detector, images(3, 96, 80))
    assert bool((after < before).all())
    if bias == -12.0:
        assert before.max() < 0.001  # fully fooled, and still a way down
