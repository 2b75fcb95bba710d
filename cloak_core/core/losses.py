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
from cloak_core.core.detector.scoring import max_objectness, max_person_score, row_max
from cloak_core.core.settings.components import Loss, Reduce
from cloak_core.core.visibility.compiled import arrays, loop, use_loops
from cloak_core.files.errors import InputError

TOP = 10
"""Boxes that reduction "topk" averages."""
SHARPNESS = 20.0
"""Of the soft maximum: boxes within 1 / SHARPNESS of the best one count."""
SURE = 1 - 2**-24
"""The largest float32 below 1: the log of a saturated score is 16.6 and not infinity."""


def disappearance(
    detections: Detections,
    kind: Loss = "score",
    reduce: Reduce = "max",
    operating_point: float = THRESHOLD,
    margin: float = 1.0,
) -> Float[Tensor, ""]:
    """Average `person_loss` over the batch."""
    return person_loss(detections, kind, reduce, operating_point, margin).mean()


def person_loss(
    detections: Detections,
    kind: Loss = "score",
    reduce: Reduce = "max",
    operating_point: float = THRESHOLD,
    margin: float = 1.0,
) -> Float[Tensor, "B"]:
    """Measure how surely each image shows a person.

    In [0, 1] for "score" and "objectness", in [0, inf) for the others.

    kind: "score", "objectness" (the reference's: boxes whose likeliest class is person; InputError for detectors
    without objectness), "log" or "margin", which alone asks for the `operating_point`, the score in (0, 1) at which the
    detector reports a person, and the `margin`, how far below it, in logits, half the gradient is left; reduce, over
    the boxes of an image: "max", "topk" or "logsumexp". No boxes count 0, but for "margin" the little that a score of 0
    does.
    """
    if kind == "objectness":
        best = max_objectness(detections) if reduce == "max" else _reduce(_person_objectness(detections), reduce)
    else:
        best = max_person_score(detections) if reduce == "max" else _reduce(detections.scores, reduce)
    if kind == "log":
        best = -torch.log1p(-best.clamp(max=SURE))
    if kind == "margin":
        best = F.softplus(torch.logit(best.clamp(1 - SURE, SURE)) - _logit(operating_point) + margin)
    return best


def proposal_loss(detections: Detections, reduce: Reduce = "max") -> Float[Tensor, "B"]:
    """Measure the first stage's objectness of proposals, each as far as it became a person (two-stage detectors).

    The product of both, its gradient reaching the first stage alone (the second has `person_loss`); a proposal that the
    second stage takes for something else may stay. InputError where there are no proposal scores.
    """
    if detections.proposal_scores is None:
        raise InputError("--rpn-weight: the detector gives no scores of proposals")
    values = detections.proposal_scores * detections.scores.detach()
    return row_max(values) if reduce == "max" else _reduce(values, reduce)


def total_variation(
    colors: Float[Tensor, "L 3"], edges: Int[Tensor, "E 2"], edge_lengths: Float[Tensor, "E"]
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
        one, other = edges[edge, 0], edges[edge, 1]
        share = lengths[edge] / np.float32(len(colors))
        for channel in range(3):
            difference = colors[one, channel] - colors[other, channel]
            total += share * abs(difference)
            push = share * np.sign(difference)
            gradient[one, channel] += push
            gradient[other, channel] -= push
    return total


def non_printability(colors: Float[Tensor, "L 3"], palette: Float[Tensor, "P 3"]) -> Float[Tensor, ""]:
    """Average the faces' Euclidean distance to the nearest colour of `palette`, sRGB in [0, 1]; at most sqrt(3).

    The non-printability score of Sharif et al., "Accessorize to a Crime" (CCS 2016), as Thys et al., "Fooling automated
    surveillance cameras" (CVPR workshops 2019) use it: Sharif's product of the distances to all palette colours
    vanishes, with its gradient, once there are more than a few of them. A colour of the palette itself has gradient 0.
    """
    # Who is nearest does not need a gradient, and [L, P] of floats is all that is kept at once.
    with torch.no_grad():
        squares = (palette**2).sum(dim=1) - 2 * colors @ palette.T
        nearest = palette[squares.argmin(dim=1)]
    # The root's gradient is infinite at 0; below a millionth of a colour there is none.
    return ((colors - nearest) ** 2).sum(dim=1).clamp_min(1e-12).sqrt().mean()


def _logit(p: float) -> float:
    p = min(max(p, 1 - SURE), SURE)
    return math.log(p / (1 - p))


def _person_objectness(detections: Detections) -> Float[Tensor, "B N"]:
    if detections.objectness is None or detections.is_person is None:
        raise InputError("--loss objectness: the detector has no objectness; use --loss score")
    return torch.where(detections.is_person, detections.objectness, 0.0)


def _reduce(values: Float[Tensor, "B N"], reduce: str) -> Float[Tensor, "B"]:
    if not values.shape[1]:
        return values.sum(dim=1)
    if reduce == "topk":
        return values.topk(min(TOP, values.shape[1]), dim=1).values.mean(dim=1)
    # Over the best boxes alone, less the log of their number: hundreds of empty boxes must not count for something.
    top = values.topk(min(TOP, values.shape[1]), dim=1).values
    return (torch.logsumexp(SHARPNESS * top, dim=1) - math.log(top.shape[1])) / SHARPNESS
