"""How a network wants its pixels, told from one photograph as far as that can be."""

import torch
from torch import nn

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.detectors.check import plausibility, try_pixels
from cloak_core.detectors.pixels import PixelFormat

BOXES = torch.tensor([[10.0, 10, 30, 50, 0.9], [60, 20, 80, 40, 0.5]])


def mirrored(boxes: torch.Tensor, width: int = 100) -> torch.Tensor:
    return torch.stack([width - boxes[:, 2], boxes[:, 1], width - boxes[:, 0], boxes[:, 3], boxes[:, 4]], dim=1)


def test_boxes_that_a_mirror_image_shows_too_are_plausible() -> None:
    assert plausibility(BOXES, mirrored(BOXES), 100) == 1.0
    assert plausibility(BOXES, BOXES, 100) == plausibility(BOXES[:0], BOXES, 100) == 0.0
    crowd = torch.cat([BOXES, BOXES + torch.tensor([3.0, 40, 3, 40, 0])])
    assert 0 < plausibility(crowd, mirrored(BOXES), 100) < plausibility(BOXES, mirrored(BOXES), 100)


class Bright(Detector):
    """Sees a person in the brightest cell of pixels in 0..255; of darker pictures nothing, of brighter ones noise."""

    def __init__(self) -> None:
        super().__init__("bright", "bright")
        self.pixels = PixelFormat()

    def detect(self, images: torch.Tensor) -> Detections:
        cells = nn.functional.avg_pool2d(self.pixels.apply(images).mean(1, keepdim=True), 8).flatten(1)
        y, x = torch.meshgrid(8.0 * torch.arange(8), 8.0 * torch.arange(8), indexing="ij")
        boxes = torch.stack([x, y, x + 8, y + 8], dim=-1).view(1, 64, 4).expand(len(images), -1, -1)
        return Detections(boxes, torch.sigmoid((cells - 200) / 20))


def test_the_right_range_comes_first_and_what_cannot_be_told_is_said() -> None:
    image = torch.full((3, 64, 64), 0.4)
    image[:, 16:24, 8:16] = 1
    detector = Bright()
    trials, undecided = try_pixels(detector, image)
    ways = [trial.pixels for trial in trials]
    assert detector.pixels == PixelFormat() and undecided == 2
    assert set(ways[:2]) == {PixelFormat(range=255.0), PixelFormat(bgr=True, range=255.0)}
    detector.pixels = PixelFormat(bgr=True, range=255.0)
    assert try_pixels(detector, image)[0][0].pixels == detector.pixels  # its own word decides between equals
