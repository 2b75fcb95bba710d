"""A detector of your own, in one file: copy it, put your network in, and check it with

    cloak detectors verify python:examples/my_detector.py:load
    cloak train --detector python:examples/my_detector.py:load ...

What is asked of `load()`: a torch.nn.Module that takes images [B, 3, H, W], RGB in [0, 1], of any size, and returns

    boxes   [B, N, 4]  x1, y1, x2, y2 in pixels of the images that were given (not of the network's own input)
    scores  [B, N]     the probability of a person in each box, 0..1, differentiable in the images

before any threshold and any suppression: what a threshold cuts off has no gradient, and a cloak is trained on exactly
that. Classes other than the person are left out here. N is yours, and may differ from image to image if you pad with
boxes of zeros and scores of 0.
"""

from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

WEIGHTS = Path(__file__).with_suffix(".pth")
"""torch.save(network.state_dict(), "my_detector.pth"); without it the network has random weights, to try the kit on."""
SIDE, STRIDE = 256, 16
"""What the network was trained at, and how many of its input's pixels a cell of its output spans."""
CLASSES, PERSON = 3, 1


class Network(nn.Module):
    """Stands for yours: four convolutions, and in every cell an objectness, class scores, and the distances from the
    cell's middle to the four sides of the box."""

    def __init__(self) -> None:
        super().__init__()
        layers, width = [], 3
        for wider in (16, 32, 64, 64):
            layers += [nn.Conv2d(width, wider, 3, stride=2, padding=1), nn.BatchNorm2d(wider), nn.SiLU()]
            width = wider
        self.body = nn.Sequential(*layers)
        self.head = nn.Conv2d(width, 1 + CLASSES + 4, 1)

    def forward(self, x: Tensor) -> Tensor:
        return self.head(self.body(x))


class MyDetector(nn.Module):
    """From the network's raw output to boxes and person scores. Every step is one that gradients pass."""

    # Say so where your network has no gradients (another runtime): it is then good for evaluation alone.
    # differentiable = False

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network
        self.register_buffer("mean", torch.tensor([0.485, 0.456, 0.406]).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor([0.229, 0.224, 0.225]).view(1, 3, 1, 1))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        height, width = images.shape[-2:]
        x = F.interpolate(images, size=(SIDE, SIDE), mode="bilinear", align_corners=False)
        grid = self.network((x - self.mean) / self.std)  # [B, 1 + classes + 4, h, w]
        rows = grid.flatten(2).transpose(1, 2)  # [B, cells, 1 + classes + 4]
        objectness, classes, sides = rows.split([1, CLASSES, 4], dim=-1)
        # A detector's own probability: of the class, given an object, times that of an object.
        scores = classes.softmax(-1)[..., PERSON] * objectness[..., 0].sigmoid()
        distance = F.softplus(sides) * STRIDE
        middle = self.middles(grid)
        boxes = torch.cat([middle - distance[..., :2], middle + distance[..., 2:]], dim=-1)
        # Back from the network's pixels to those of the images.
        return boxes * boxes.new_tensor([width / SIDE, height / SIDE] * 2), scores

    @staticmethod
    def middles(grid: Tensor) -> Tensor:
        """x, y of every cell's middle, pixels of the network's input."""
        rows, columns = grid.shape[-2:]
        y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
        return (torch.stack([x, y], dim=-1).reshape(-1, 2).to(grid) + 0.5) * STRIDE


def load() -> nn.Module:
    """What the spec names. Eval mode and frozen parameters are seen to by Cloak."""
    with torch.random.fork_rng():  # the same random weights each time, and nobody else's random numbers changed
        torch.manual_seed(0)
        network = Network()
    if WEIGHTS.is_file():
        network.load_state_dict(torch.load(WEIGHTS, weights_only=True))
    return MyDetector(network)
