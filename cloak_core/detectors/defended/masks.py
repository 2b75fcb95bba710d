"""A floor under one small patch: masks over the image, so that some answer never saw the patch.

The masks are PatchCleanser's (Xiang et al., USENIX Security 2022): equal rectangles on a grid, so placed that every
square of `patch` pixels a side lies wholly under one of them. The answers are joined as by ObjectSeeker (Xiang et al.,
IEEE S&P 2023), with one rule made stricter: a box explains another away only where it scores at least as high.

What is certified. Let two images differ only within one axis-aligned square of `patch` pixels a side, wherever it lies
and whatever it shows. Some mask covers that square, and under it both images are equal, so a deterministic detector
answers alike. Let b be a person box of the answer to the first image under that mask, with score s. Then for the second
image the defended detector reports b itself, or a box with a score of at least s that holds at least the share
`EXPLAINED` of b. So a person on whom the answer under *every* mask has a box above a threshold cannot be hidden at that
threshold by one such patch. Nothing is said of two patches, of larger ones (a shirt), of other shapes that no such
square holds, or of how exactly the box fits.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.detectors.defended.detector import Defence

GRID = 6
"""Masks along each side of the image."""
FILL = 0.5
"""What a mask shows; it must not depend on the image, for the patch is part of that."""
EXPLAINED = 0.8
"""Least share of a box under a mask that lies in a box of the whole image which explains it."""
KEPT = 100
"""Boxes with the highest scores that are kept of each answer under a mask, and that may explain them."""


class Masks(Defence):
    """Ask about the image and about each of GRID x GRID masked copies; report what any of them shows."""

    @property
    def patch(self) -> int:
        """Side of the patch, pixels."""
        return round(self.value)

    def answers(self, inner: Detector, images: Float[Tensor, "B 3 H W"]) -> Iterator[Detections]:
        """Ask the detector about the images under one mask after the other: the KEPT best boxes of each answer."""
        height, width = images.shape[2:]
        for top, bottom in spans(height, self.patch):
            for left, right in spans(width, self.patch):
                masked = torch.zeros(height, width, dtype=torch.bool, device=images.device)
                masked[top:bottom, left:right] = True
                yield _best(inner(images.masked_fill(masked, FILL)))

    def detect(self, inner: Detector, images: Float[Tensor, "B 3 H W"]) -> Detections:
        """Join the answers: those under masks without the boxes that the whole image's boxes explain."""
        whole = inner(images)
        best = _best(whole)
        b, b_scores = best.boxes.detach()[:, None], best.scores[:, None]
        answers = []
        for answer in self.answers(inner, images):
            a = answer.boxes.detach()[:, :, None]
            sides = (torch.minimum(a[..., 2:], b[..., 2:]) - torch.maximum(a[..., :2], b[..., :2])).clamp(min=0)
            own = (a[..., 2:] - a[..., :2]).clamp(min=0).prod(-1)
            # A box lies in one of the whole image that scores at least as high.
            explained = ((sides.prod(-1) >= EXPLAINED * own) & (b_scores >= answer.scores[:, :, None])).any(2)
            # In its place stands padding: a box of zeros and scores of 0.
            answers.append(
                answer.each(lambda part, d=explained: part.masked_fill(d.view(d.shape + (1,) * (part.dim() - 2)), 0))
            )
        return Detections(
            *(None if parts[0] is None else torch.cat(parts, 1) for parts in zip(whole, *answers, strict=True))
        )


def spans(length: int, patch: int) -> list[tuple[int, int]]:
    """Place masks along a side: [begin, end) of each; every run of `patch` pixels lies within one."""
    step = -(-max(1, length - patch + 1) // GRID)
    side = min(length, patch + step - 1)
    return [(begin, begin + side) for begin in sorted({min(k * step, length - side) for k in range(GRID)})]


def _best(detections: Detections) -> Detections:
    rows = detections.scores.topk(min(KEPT, detections.scores.shape[1]), dim=1).indices
    return detections.each(lambda part: part[torch.arange(len(rows), device=rows.device)[:, None], rows])
