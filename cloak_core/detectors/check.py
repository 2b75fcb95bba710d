"""What a detector says about one photograph: numbers, and a picture with its boxes drawn."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from PIL import ImageOps
from torch import Tensor

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.detector.scoring import THRESHOLD, box_iou, draw_boxes, max_person_score, person_boxes, suppressed
from cloak_core.core.pictures import open_picture, save_picture
from cloak_core.detectors.pixels import USUAL, PixelFormat
from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    from cloak_core.detectors.onnx_family.detector import OnnxDetector


def check_image(
    detector: Detector, image: Path, *, threshold: float = THRESHOLD, out: Path | None = None
) -> dict[str, object]:
    """Run a detector on one image file (any size and mode; EXIF orientation applied).

    Returns {"max_person": best person score, thresholded or not, "boxes": [[x1, y1, x2, y2, score], ...]: the boxes
    above `threshold` after non-maximum suppression, in the file's pixels, best first, "operating_point": the score from
    which the detector itself reports, "operating_point_assumed": whether nobody said so, "reported": how many boxes
    stand above that, likewise}. Where nobody said how the network wants its pixels, "pixels" has the best person score
    of each usual way by the options of a spec, the likeliest way first (`try_pixels`), "pixels_plausible" how
    plausible its boxes are, and "pixels_undecided" the ways that one picture cannot tell apart. With `out`, also writes
    the picture with those boxes drawn. InputError names a file that cannot be read or written.
    """
    if out is not None and (out.suffix.lower() not in (".png", ".jpg", ".jpeg") or not out.absolute().parent.is_dir()):
        raise InputError(f"{out}: give a .png or .jpg in a folder that exists")
    pixels = read_image(image)
    with torch.no_grad():
        detections = detector(pixels[None].to(detector.device))
    boxes = person_boxes(detections, threshold)[0]
    if out is not None:
        save_picture(out, draw_boxes(pixels, boxes))
    report: dict[str, object] = {
        "max_person": max_person_score(detections).item(),
        "boxes": boxes.tolist(),
        "operating_point": detector.operating_point,
        "operating_point_assumed": detector.operating_point_assumed,
        "reported": len(person_boxes(detections, detector.operating_point)[0]),
    }
    if getattr(detector, "pixels_assumed", False):
        trials, undecided = try_pixels(detector, pixels)
        report["pixels"] = {trial.pixels.options: trial.max_person for trial in trials}
        report["pixels_plausible"] = {trial.pixels.options: trial.plausibility for trial in trials}
        report["pixels_undecided"] = [trial.pixels.options for trial in trials[:undecided]]
    return report


def read_image(path: Path) -> Float[Tensor, "3 H W"]:
    """Read an image file as RGB in [0, 1]. InputError: missing, no image, broken or huge."""
    with open_picture(path) as file:
        pixels = np.array(ImageOps.exif_transpose(file).convert("RGB"))
    return torch.from_numpy(pixels).permute(2, 0, 1).float() / 255


SHOWN, SAME, MOST = 0.2, 0.5, 50
"""Look at boxes above this score, at most this number; two that overlap this much (IoU) count as one."""
AS_PLAUSIBLE = 0.7
"""Of the most plausible way's: of 84 trials on three detectors, the right way was among these in 80, and never was a
wrong one alone."""


class Trial(NamedTuple):
    """What one way of handing over pixels gives."""

    pixels: PixelFormat
    max_person: float
    plausibility: float
    """0..1; see `plausibility`."""


@torch.no_grad()
def try_pixels(detector: OnnxDetector, image: Float[Tensor, "3 H W"]) -> tuple[list[Trial], int]:
    """Try every usual way, and the detector's own; best first, with the number that cannot be told apart.

    The detector's own comes first where it is among those, then the others by their plausibility. The best score does
    not tell: a picture 255 times too bright gives hundreds of sure boxes. What does is whether a photograph and its
    mirror image show the same things. Networks hardly mind red and blue exchanged, or a mean subtracted, so several
    ways are often as plausible; then the file's own word counts.
    """
    before, trials = detector.pixels, []
    try:
        for detector.pixels in dict.fromkeys((before, *USUAL)):
            boxes = [_boxes(detector, side) for side in (image, image.flip(2))]
            best = max_person_score(detector(image[None])).item()
            trials.append(Trial(detector.pixels, best, plausibility(*boxes, image.shape[2])))
    finally:
        detector.pixels = before
    least = AS_PLAUSIBLE * max(trial.plausibility for trial in trials)
    trials.sort(key=lambda t: (t.plausibility < least, t.pixels != before, -t.plausibility))
    return trials, sum(trial.plausibility >= least for trial in trials)


def plausibility(boxes: Float[Tensor, "n 5"], mirrored: Float[Tensor, "m 5"], width: int) -> float:
    """Measure how far a picture and its mirror image show the same boxes (corners and score), 0 to 1.

    The share of all scores that agree, by overlap and by the lower score; less where there is hardly a box at all.
    """
    if not len(boxes) or not len(mirrored):
        return 0.0
    left, right = width - mirrored[:, 2], width - mirrored[:, 0]
    back = torch.stack([left, mirrored[:, 1], right, mirrored[:, 3]], dim=1)
    iou, partner = box_iou(boxes[:, None, :4], back[None]).max(dim=1)
    agreeing = torch.where(iou > SAME, iou * torch.minimum(boxes[:, 4], mirrored[partner, 4]), 0.0).sum().item()
    share = 2 * agreeing / (boxes[:, 4].sum() + mirrored[:, 4].sum()).item()
    return share * min(1.0, agreeing)


def _boxes(detector: OnnxDetector, image: Float[Tensor, "3 H W"]) -> Float[Tensor, "n 5"]:
    """Find boxes of any class, after suppression, best first."""
    detections = detector(image[None])
    scores = detections.scores if detections.other is None else torch.maximum(detections.scores, detections.other)
    return suppressed(detections.boxes[0], scores[0], SHOWN, SAME)[:MOST]
