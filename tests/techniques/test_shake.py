"""A shaken detector is another network in every step and image, and the same one afterwards."""

import contextlib

import pytest
import torch
from torch import nn

from cloak_core.core.detector.protocol import Detections, Detector, state_hash
from cloak_core.files.errors import InputError
from cloak_core.techniques.shake import Shake
from tests.core.fakes import TinyDetector
from tests.core.test_training import run

IMAGES = torch.rand(3, 3, 16, 16, generator=torch.Generator().manual_seed(0))


class Residual(Detector):
    """One residual block of known weights: x, then x + branch(x)."""

    def __init__(self) -> None:
        super().__init__("residual", "residual")
        self.stem, self.branch = nn.Conv2d(3, 8, 1, bias=False), nn.Conv2d(8, 8, 1, bias=False)
        with torch.no_grad():
            self.stem.weight.copy_(torch.eye(8, 3)[:, :, None, None])
            self.branch.weight.copy_(torch.eye(8)[:, :, None, None])
        self.freeze()

    def forward(self, images: torch.Tensor) -> Detections:
        x = self.stem(images).relu_()
        x = self.branch(x) + x[:, :8]  # as Darknet's shortcuts take the channels that both have
        scores = x[:, :3].mean((2, 3)) / 2
        return Detections(scores.new_zeros(*scores.shape, 4), scores)


def scores(step: int | None, detector: Detector | None = None, seed: int = 0, shake: float = 0.0) -> torch.Tensor:
    detector = detector or Residual()
    with contextlib.nullcontext() if step is None else Shake(shake, seed).detector_context(0, step):
        return detector(IMAGES).scores


def test_shaking_scales_the_branch_of_each_image_and_leaves_the_way_around():
    plain, shaken = scores(None, shake=0.5), scores(1, shake=0.5)
    ratio = shaken / plain  # (1 + factor) / 2 with a factor in 0.5 .. 1.5
    assert ((ratio > 0.75) & (ratio < 1.25)).all()
    torch.testing.assert_close(ratio, ratio[:, :1].expand_as(ratio))  # the whole branch of an image alike
    assert ratio[:, 0].unique().numel() == 3  # and each image's its own


def test_what_is_drawn_is_a_function_of_seed_and_step_and_the_detector_stays_as_it_was():
    detector = Residual()
    before, plain = state_hash(detector), detector(IMAGES).scores
    first = scores(4, detector, shake=0.3)
    assert torch.equal(first, scores(4, detector, shake=0.3))
    assert not torch.equal(first, scores(5, detector, shake=0.3))
    assert not torch.equal(first, scores(4, detector, seed=1, shake=0.3))
    assert state_hash(detector) == before and torch.equal(detector(IMAGES).scores, plain)


def test_two_maps_of_which_none_was_read_are_both_shaken():
    one, other = torch.ones(1, 8, 2, 2), torch.ones(1, 8, 2, 2)
    with Shake(0.5, 0).detector_context(0, 0):
        total = one + other
        small = one[:, :4] + other[:, :4]  # too few channels for features
    assert total.unique().numel() == 1 and 1 < float(total[0, 0, 0, 0]) < 3 and float(total[0, 0, 0, 0]) != 2
    assert (small == 2).all() and (one == 1).all()


def test_compiled_detectors_are_refused(tmp_path):
    detector = TinyDetector()
    detector.compiled = True
    with pytest.raises(InputError, match="tiny:0: compiled"):
        run(tmp_path / "run", [detector], shake=0.1)
