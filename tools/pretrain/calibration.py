"""Makes 0.6 a sensible threshold: a temperature and a bias for the objectness logit, folded into the last layer."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector.scoring import THRESHOLD
from cloak_core.detectors.darknet.layers import Convolution
from cloak_core.detectors.darknet.network import Network

FALSE_ALARM_WEIGHT = 3.0
"""How many missed people one false alarm is worth."""


class Calibration(NamedTuple):
    """logit' = scale * logit + shift, and what that gives on the images it was fitted to."""

    scale: float
    shift: float
    recall: float
    false_alarms: float


def calibrate(
    people: Float[Tensor, " P"], places: Float[Tensor, " N"], false_alarm_weight: float = FALSE_ALARM_WEIGHT
) -> Calibration:
    """From the best logit on each image with a person and on each without.

    The slope is that of a logistic regression of "is there a person" (so that scores read as probabilities); the
    shift puts 0.6 where misses plus `false_alarm_weight` times false alarms are fewest, in the middle of that range.
    """
    logits = torch.cat([people, places]).double()
    truth = torch.cat([torch.ones_like(people), torch.zeros_like(places)]).double()
    weight = torch.where(truth > 0, 0.5 / len(people), 0.5 / len(places))
    line = torch.tensor([1.0, 0.0], dtype=torch.float64, requires_grad=True)
    fit = torch.optim.LBFGS([line], max_iter=200, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        fit.zero_grad()
        loss = torch.nn.functional.binary_cross_entropy_with_logits(
            line[0] * logits + line[1], truth, weight, reduction="sum"
        )
        loss = loss + 1e-4 * line[0] ** 2  # separable data would ask for an infinite slope
        loss.backward()
        return loss

    fit.step(closure)
    scale = float(line[0].detach().clamp(0.3, 1.5))
    cut = best_cut(people, places, false_alarm_weight)
    shift = float(torch.logit(torch.tensor(THRESHOLD))) - scale * cut
    return Calibration(scale, shift, float((people > cut).float().mean()), float((places > cut).float().mean()))


def best_cut(
    people: Float[Tensor, " P"], places: Float[Tensor, " N"], false_alarm_weight: float = FALSE_ALARM_WEIGHT
) -> float:
    """The threshold with the fewest misses plus weighted false alarms; the middle where several do equally well."""
    edges = torch.cat([people, places]).sort().values
    cuts = (edges[1:] + edges[:-1]) / 2
    misses = (people[:, None] <= cuts).float().mean(0)
    alarms = (places[:, None] > cuts).float().mean(0)
    cost = misses + false_alarm_weight * alarms
    return float(cuts[cost <= cost.min() + 1e-9].median())


@torch.no_grad()
def apply_calibration(network: Network, calibration: Calibration) -> None:
    """Fold it into the objectness rows of the network's last convolution, and silence the single class's rows."""
    head = network.heads[0]
    last = [layer for layer in network.layers if isinstance(layer, Convolution)][-1]
    rows = torch.arange(len(head.anchors)) * (5 + head.classes)
    last.conv.weight[rows + 4] *= calibration.scale
    last.conv.bias[rows + 4] = last.conv.bias[rows + 4] * calibration.scale + calibration.shift
    last.conv.weight[rows + 5] = 0
    last.conv.bias[rows + 5] = 0
