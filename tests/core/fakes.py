"""A tiny scene and a tiny detector: everything training needs, small enough to run it hundreds of times."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from torch import nn

from cloak_core.core.batches import Batcher
from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.linear import SparseMap
from cloak_core.core.logo import Logo, make_logo
from cloak_core.core.pattern import Pattern
from cloak_core.core.places import Places
from cloak_core.core.sampling import Sampler
from cloak_core.core.settings import TrainSettings, make_settings
from cloak_core.core.source import Dealt
from cloak_core.core.technique import Techniques
from cloak_core.core.view import BakedView, Box, Subject
from cloak_core.exchange.bodies import Bodies
from cloak_core.patterns.choosing import pattern_of
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.backdrops.backgrounds import Backgrounds
from cloak_core.sources.bodies.source import BodySource
from cloak_core.techniques import build_techniques

Answer = Callable[[torch.Tensor], torch.Tensor]
SIDE = 4
"""Quads along each side of each face of the box."""


def box_bodies(poses: int = 2) -> Bodies:
    """A box of 1 x 1.6 x 0.6 m, each side a grid of quads; later poses are turned a little and stretched."""
    steps = np.linspace(-0.5, 0.5, SIDE + 1)
    u, v = (a.ravel() for a in np.meshgrid(steps, steps, indexing="ij"))
    quads = [[i * (SIDE + 1) + j, (i + 1) * (SIDE + 1) + j, (i + 1) * (SIDE + 1) + j + 1, i * (SIDE + 1) + j + 1]
             for i in range(SIDE) for j in range(SIDE)]  # fmt: skip
    half = np.full_like(u, 0.5)
    sides = [(u, v, half), (-u, v, -half), (half, v, -u), (-half, v, u), (u, half, -v), (u, -half, v)]
    points = np.concatenate([np.stack(side, 1) for side in sides])
    loops = np.concatenate([np.array(quads) + k * (SIDE + 1) ** 2 for k in range(6)])
    # Neighbouring sides share their edge's vertices, so that the box is closed.
    points, where = np.unique(points.round(6), axis=0, return_inverse=True)
    loops = where.reshape(-1)[loops]
    vertices = np.stack([_turned(points * (1, 1.6, 0.6 + 0.1 * pose), 0.2 * pose) for pose in range(poses)])
    faces = len(loops)
    random = np.random.default_rng(0)
    return Bodies(
        vertices=vertices.astype(np.float32),
        triangles=loops[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3),
        triangle_face=np.repeat(np.arange(faces), 2),
        face_colors=random.uniform(0.2, 0.8, (2, faces, 3)).astype(np.float32),
        loop_total=np.full(faces, 4),
        loop_vertices=loops.ravel(),
        name="box",
    )


def _turned(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


def front_logo(bodies: Bodies) -> Logo:
    """The quads of the side that faces +z."""
    return make_logo(bodies, np.arange(SIDE * SIDE))


def back_logo(bodies: Bodies) -> Logo:
    """The quads of the far side, which no training view sees."""
    return make_logo(bodies, SIDE * SIDE + np.arange(SIDE * SIDE))


def noise_backgrounds(count: int = 5) -> Backgrounds:
    draw = lambda index, height, width: (
        np.random.default_rng(index).integers(0, 255, (height, width, 3)).astype(np.uint8)
    )
    return Backgrounds([f"noise {i}" for i in range(count)], draw)


class MadeViews:
    """A source that judges alone: it gives the view of the number in column `pose`, whatever is worn."""

    directions, is_fresh, works_on = 1, False, torch.device("cpu")

    def __init__(self, *views: BakedView, identity: str | None = None) -> None:
        self.views, self.identity, self.members = views, identity, len(views)

    def draw(self, dealt: Dealt, random: np.random.Generator) -> dict[str, np.ndarray]:
        raise AssertionError("nobody trains on them")

    def view(self, shown: Mapping[str, int | float], seed: int | None, pattern: Pattern) -> BakedView:
        return self.views[shown["pose"]]

    def require_visible(self, pattern: Pattern) -> None:
        raise AssertionError("nobody trains on them")


def box_of(mask: torch.Tensor) -> Box:
    """The bounding box (x0, y0, x1, y1) of a mask [H, W] that is not empty."""
    rows, columns = (mask.any(axis).nonzero().view(-1).tolist() for axis in (1, 0))
    return columns[0], rows[0], columns[-1] + 1, rows[-1] + 1


def photograph_view(
    picture: torch.Tensor, mask: torch.Tensor, others: tuple[Box, ...] = (), worn: bool = False
) -> BakedView:
    """A person in a picture [3, H, W], at the mask's pixels; worn: all of it shows the one place, else nothing does."""
    _, height, width = picture.shape
    pixels = torch.arange(height * width)
    rows = len(pixels) if worn else 0
    shown = SparseMap(torch.arange(rows + 1), torch.zeros(rows, dtype=torch.int64), torch.ones(rows), 1)
    return BakedView(
        height,
        width,
        pixels,
        torch.ones(len(pixels)),
        picture.reshape(3, -1),
        rows,
        shown,
        Places.of_faces(1),
        torch.zeros(1, 3),
        (1.0, 1.0, 1.0),
        Subject(box_of(mask), others, False, lambda: mask),
    )


class TinyDetector(Detector):
    """Two seeded convolutions; a box for each cell of a coarse grid. Smooth, so that finite differences work."""

    def __init__(self, seed: int = 0, bias: float = 0.0) -> None:
        super().__init__("tiny", f"tiny:{seed}")
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.body = nn.Sequential(nn.Conv2d(3, 8, 8, stride=8), nn.Tanh(), nn.Conv2d(8, 6, 3, padding=1))
        self.bias = bias
        self.freeze()

    def forward(self, images: torch.Tensor) -> Detections:
        raw = self.body(images).flatten(2).transpose(1, 2)
        objectness = torch.sigmoid(4 * raw[..., 0] + self.bias)
        person = torch.sigmoid(4 * raw[..., 1])
        boxes = torch.cat([raw[..., 2:4], raw[..., 2:4] + raw[..., 4:].exp()], dim=2)
        return Detections(boxes, objectness * person, objectness, person > 0.5)


class RedDetector(Detector):
    """Finds persons where an 8 x 8 cell is redder than blue, and says where the cells are."""

    def __init__(self) -> None:
        super().__init__("red", "red")

    def forward(self, images: torch.Tensor) -> Detections:
        cells = nn.functional.avg_pool2d(images, 8)
        y, x = torch.meshgrid(*(8.0 * torch.arange(side) for side in cells.shape[2:]), indexing="ij")
        red, green, blue = cells.flatten(2).unbind(1)
        scores = torch.sigmoid(6 * (red - blue) + 2 * green)
        boxes = torch.stack([x, y, x + 8, y + 8], dim=-1).flatten(0, 1).expand(*scores.shape, 4)
        return Detections(boxes, scores, scores, scores > 0)


def middle(images: torch.Tensor) -> torch.Tensor:
    """The middle of each image, as boxes [B, 4]."""
    return torch.tensor([0.25, 0.1, 0.75, 0.9]).mul(images.shape[-1]).expand(len(images), 4)


def around(masks: torch.Tensor) -> torch.Tensor:
    """Boxes [B, 4] around what is true in masks [B, H, W]."""
    return torch.tensor([box_of(mask) if mask.any() else (0, 0, 0, 0) for mask in masks]).float()


class Says(Detector):
    """Reports a box in each image: functions of the images tell the scores [B] and the boxes [B, 4]."""

    def __init__(self, score: Answer, boxes: Answer = middle, name: str = "says") -> None:
        super().__init__(name, name)
        self.score, self.boxes, self.weight = score, boxes, nn.Parameter(torch.ones(1))
        self.freeze()

    def forward(self, images: torch.Tensor) -> Detections:
        return Detections(self.boxes(images)[:, None], self.score(images)[:, None])


class BrokenDetector(TinyDetector):
    """Returns NaN from call `at` on, in its scores or (the scores being fine) in its gradient."""

    def __init__(self, at: int, in_gradient: bool = False) -> None:
        super().__init__()
        self.calls, self.at, self.in_gradient = 0, at, in_gradient

    def forward(self, images: torch.Tensor) -> Detections:
        self.calls += 1
        found = super().forward(images)
        if self.calls < self.at:
            return found
        # The gradient of sqrt at 0 is infinite, times 0 is NaN.
        scores = found.scores + (0 * images.sum()).sqrt() if self.in_gradient else found.scores * torch.nan
        return found._replace(scores=scores)


def tiny_settings(**changes: object) -> TrainSettings:
    base = {
        "steps": 6,
        "batch": 3,
        "size": 64,
        "translation": 5,
        "samples": 1,
        "checkpoint_every": 2,
        "preview_every": 3,
    }
    return make_settings("best", **(base | {"angles": "-10,10"} | changes))


class RenamingDetector(RedDetector):
    """Knows persons, where a cell is redder than blue, and dogs, where it is bluer than red."""

    class_names = ("person", "dog")

    def forward(self, images: torch.Tensor) -> Detections:
        red, _, blue = nn.functional.avg_pool2d(images, 8).flatten(2).unbind(1)
        scores, other = torch.sigmoid(6 * (red - blue)), torch.sigmoid(6 * (blue - red))
        dogs = torch.ones_like(other, dtype=torch.int64)
        return Detections(super().forward(images).boxes, scores, other=other, other_class=dogs)


def tiny_batcher(settings: TrainSettings, logo: Logo | None = None) -> Batcher:
    """Builds batches of a box's front before noise, as a training with these settings does."""
    bodies, backgrounds = box_bodies(), noise_backgrounds()
    sampler = Sampler(settings, BodySource.trained(bodies, settings.views), len(backgrounds))
    pattern = FacePattern(logo or front_logo(bodies), bodies)
    return Batcher(settings, sampler, backgrounds, pattern, torch.device("cpu"))


def techniques_of(
    settings: TrainSettings, detectors: Sequence[Detector] = (), bodies: Bodies | None = None
) -> Techniques:
    """The techniques that the settings have on, for the front of a box."""
    bodies = bodies or box_bodies()
    pattern = pattern_of(settings.pattern, bodies, front_logo(bodies))
    return build_techniques(settings, pattern, detectors, torch.device("cpu"))[0]
