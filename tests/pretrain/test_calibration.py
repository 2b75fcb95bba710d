"""Calibration: 0.6 must come to lie where people and places part, and the fold must do what it says."""

import torch

from cloak_core.core.detector.scoring import THRESHOLD
from cloak_core.detectors.darknet.cfg import read_cfg_text
from cloak_core.detectors.darknet.detector import BUILTIN_CFG
from cloak_core.detectors.darknet.network import build_network
from tools.pretrain.calibration import apply_calibration, best_cut, calibrate


def test_threshold_lies_between_separable_classes():
    people, places = torch.linspace(3, 6, 50), torch.linspace(-6, -1, 50)
    fitted = calibrate(people, places)
    score = lambda logits: (fitted.scale * logits + fitted.shift).sigmoid()
    assert score(people).min() > THRESHOLD > score(places).max()
    assert fitted.recall == 1 and fitted.false_alarms == 0
    assert abs(best_cut(people, places) - 1.0) < 1e-4, "the middle of the gap"


def test_fold_changes_objectness_alone():
    network = build_network(read_cfg_text(BUILTIN_CFG), input_size=(64, 64), seed=3).eval()
    images = torch.rand(2, 3, 64, 64)
    fitted = calibrate(torch.tensor([1.0, 2.0, 4.0]), torch.tensor([-3.0, 0.0, 1.5]))
    with torch.no_grad():
        before = network.heads[0].split(network(images)[0])
        apply_calibration(network, fitted)
        after = network.heads[0].split(network(images)[0])
    torch.testing.assert_close(after[:, :, 4], before[:, :, 4] * fitted.scale + fitted.shift, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(after[:, :, :4], before[:, :, :4])
    assert torch.all(after[:, :, 5] == 0)
