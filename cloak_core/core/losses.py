"""What training minimises: how surely a person is found, plus how restless the colours are.

Gradients: "score" is the detector's own probability p, whose gradient through a sigmoid fades as p (1 - p), at both
ends; a score under the detection threshold still has one. "log" is -log(1 - p), whose gradient with respect to the
logit is p: full strength where the detector is sure, fading only where the person is already hidden. "margin" is the
same, moved to the point at which the detector is run: full strength down to that score, fading only a margin below it.
Where a detector's own arithmetic has rounded p to exactly 1, its gradient is 0 and no loss can bring it back.
"""

import math

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.detector.protocol import Detections
from cloak_core.core.detector.scoring import max_objectness, max_person_score
from cloak_core.core.settings.components import Loss
from cloak_core.core.visibility.compiled import arrays, loop, use_loops

SURE = 1 - 2**-24
"""The largest float32 below 1: the log of a saturated score is 16.6 and not infinity."""
MARGIN = 1.0
"""Logits below the operating point at which half of the gradient of the loss "margin" is left."""


def person_loss(
    detections: Detections,
    kind: Loss = "score",
    operating_point: float = THRESHOLD,
) -> Float[Tensor, " B"]:
    """Measure how surely each image shows a person, by its surest box.

    In [0, 1] for "score" and "objectness", in [0, inf) for the others.

    kind: "score", "objectness" (the reference's: boxes whose likeliest class is person; InputError for detectors
    without objectness), "log" or "margin", which alone asks for the `operating_point`, the score in (0, 1) at which the
    detector reports a person: half the gradient is left `MARGIN` below it. No boxes count 0, but for "margin" the
    little that a score of 0 does.
    """
    if kind == "objectness":
        best = max_objectness(detections)
    else:
        best = max_person_score(detections)
    if kind == "log":
        best = -torch.log1p(-best.clamp(max=SURE))
    if kind == "margin":
        point = min(max(operating_point, 1 - SURE), SURE)
        best = F.softplus(torch.logit(best.clamp(1 - SURE, SURE)) - math.log(point / (1 - point)) + MARGIN)
    return best


def total_variation(
    colors: Float[Tensor, "L 3"], edges: Int[Tensor, "E 2"], edge_lengths: Float[Tensor, " E"]
) -> Float[Tensor, ""]:
    """Sum over inner edges of length (metres) times absolute colour difference summed over channels, divided by L.

    edges: positions of the two faces in `colors`; edge_lengths: in the first pose.
    """
    if use_loops(colors.device):
        return _VariationByLoop.apply(colors, edges, edge_lengths)
    # Indexing, not index_select: its gradient is accumulated in a fixed order on CUDA, too.
    ends = colors[edges]
    return ((ends[:, 0] - ends[:, 1]).abs().sum(dim=1) * edge_lengths).sum() / len(colors)


class _VariationByLoop(torch.autograd.Function):
    """Value and gradient in one loop over the edges."""

    @staticmethod
    def forward(ctx: object, colors: Tensor, edges: Tensor, edge_lengths: Tensor) -> Tensor:
        gradient = torch.zeros_like(colors, memory_format=torch.contiguous_format)
        total = _variation(*arrays(colors, edges, edge_lengths, gradient))
        ctx.save_for_backward(gradient)
        return colors.new_tensor(total)

    @staticmethod
    def backward(ctx: object, upstream: Tensor) -> tuple[Tensor, None, None]:
        (gradient,) = ctx.saved_tensors
        return gradient * upstream, None, None


@loop
def _variation(colors: np.ndarray, edges: np.ndarray, lengths: np.ndarray, gradient: np.ndarray) -> float:
    total = 0.0
    for edge in range(len(edges)):
        first, second = edges[edge, 0], edges[edge, 1]
        weight = lengths[edge] / np.float32(len(colors))
        for channel in range(3):
            difference = colors[first, channel] - colors[second, channel]
            total += weight * abs(difference)
            push = weight * np.sign(difference)
            gradient[first, channel] += push
            gradient[second, channel] -= push
    return total
