"""The YOLOv2 loss for one class: which cell and anchor answers for which box, and how wrong it is."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from cloak_core.core.detector.scoring import box_iou
from cloak_core.detectors.decoding import AnchorBoxes

IGNORE_IOU = 0.5
"""A prediction that overlaps a person this much is never told that it sees nothing."""
BOX_WEIGHT = 0.5
CLIP = 1e-3
"""Centres stay this far from the cell's border, so that their logits stay finite."""


class Targets(NamedTuple):
    """What the raw map should say, for B images, A anchors and h x w cells."""

    assigned: Bool[Tensor, "B A h w"]
    """The one anchor and cell of each box: the cell its centre lies in, the anchor nearest to it in shape."""
    boxes: Float[Tensor, "B A 4 h w"]
    """Where assigned: x, y within the cell (0..1), log of width and height over the anchor's."""


def encode(
    boxes: Float[Tensor, "B M 4"], present: Bool[Tensor, "B M"], anchors: Float[Tensor, "A 2"], grid: tuple[int, int]
) -> Targets:
    """Boxes (xyxy, fractions of the input; rows that are not `present` count for nothing) as targets.

    anchors: width and height in cells; grid: (rows, columns) of cells. Two boxes that claim one place: the later wins.
    """
    rows, columns = grid
    cells = torch.tensor([columns, rows], dtype=boxes.dtype, device=boxes.device)
    size = (boxes[..., 2:] - boxes[..., :2]) * cells
    centre = (boxes[..., 2:] + boxes[..., :2]) / 2 * cells
    smaller = torch.minimum(size[..., None, :], anchors).prod(-1)
    union = size.prod(-1)[..., None] + anchors.prod(-1) - smaller
    best = (smaller / union).argmax(-1)
    corner = torch.minimum(centre.floor().clamp(min=0), cells - 1)
    image, row = torch.nonzero(present, as_tuple=True)
    place = (image, best[image, row], corner[image, row, 1].long(), corner[image, row, 0].long())
    shape = (len(boxes), len(anchors), rows, columns)
    assigned = torch.zeros(shape, dtype=torch.bool, device=boxes.device)
    assigned[place] = True
    inside = (centre - corner)[image, row].clamp(CLIP, 1 - CLIP)
    scale = torch.log(size[image, row] / anchors[place[1]])
    values = boxes.new_zeros((*shape, 4))
    values[place] = torch.cat([inside, scale], 1)
    return Targets(assigned, values.permute(0, 1, 4, 2, 3))


class Losses(NamedTuple):
    """Means over the batch's images."""

    objectness: Float[Tensor, ""]
    box: Float[Tensor, ""]

    @property
    def total(self) -> Tensor:
        return self.objectness + BOX_WEIGHT * self.box


def region_loss(
    raw: Float[Tensor, "B C h w"],
    head: AnchorBoxes,
    boxes: Float[Tensor, "B M 4"],
    present: Bool[Tensor, "B M"],
    ignored: Bool[Tensor, "B M"],
) -> Losses:
    """The loss of a raw map against true boxes (xyxy, fractions of the input).

    `present` boxes must be found; around `ignored` ones (mostly hidden or outside the picture) anything may be said.
    The objectness target is 1, not the overlap, so that scores read as probabilities of a person.
    """
    grid = (raw.shape[-2], raw.shape[-1])
    split = head.split(raw.float())
    targets = encode(boxes, present, head.anchors, grid)
    with torch.no_grad():
        predicted = head.decode(raw.detach().float(), (32 * grid[0], 32 * grid[1])).boxes
        overlap = box_iou(predicted[:, :, None], boxes[:, None]) * (present | ignored)[:, None]
        spared = (overlap.amax(-1) > IGNORE_IOU).reshape(targets.assigned.shape) & ~targets.assigned
        spared |= _centres_inside(boxes, ignored, grid)[:, None] & ~targets.assigned
    logits, truth = split[:, :, 4], targets.assigned.float()
    each = F.binary_cross_entropy_with_logits(logits, truth, reduction="none")
    weight = (1 + truth) * (~spared)
    objectness = (each * weight).sum() / len(raw)
    at = targets.assigned
    found, wanted = split[:, :, :4].movedim(2, -1)[at], targets.boxes.movedim(2, -1)[at]
    centre = F.binary_cross_entropy_with_logits(found[:, :2], wanted[:, :2], reduction="none")
    size = F.smooth_l1_loss(found[:, 2:], wanted[:, 2:], reduction="none", beta=0.1)
    return Losses(objectness, (centre + 2 * size).sum() / len(raw))


def _centres_inside(
    boxes: Float[Tensor, "B M 4"], chosen: Bool[Tensor, "B M"], grid: tuple[int, int]
) -> Bool[Tensor, "B h w"]:
    """Cells whose middle lies in a chosen box."""
    y = (torch.arange(grid[0], device=boxes.device) + 0.5) / grid[0]
    x = (torch.arange(grid[1], device=boxes.device) + 0.5) / grid[1]
    x0, y0, x1, y1 = (boxes * chosen[..., None]).unbind(-1)
    across = (x >= x0[..., None]) & (x < x1[..., None])
    down = (y >= y0[..., None]) & (y < y1[..., None])
    return (down[..., :, None] & across[..., None, :]).any(1)
