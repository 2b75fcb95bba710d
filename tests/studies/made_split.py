"""Tiny detectors, a small data split and a tiny card, to train and judge on within seconds."""

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from cloak_core.core.detector.protocol import Detections, Detector
from cloak_core.core.evaluation.settings import StoreOptions
from cloak_core.experiments.options import Options
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.studies.card.protocol import Size
from cloak_core.studies.store import DataSplit, RunStore


class Glow(Detector):
    """A person is what is bright in the middle, in one colour channel."""

    def __init__(self, name: str, channel: int) -> None:
        super().__init__(name, name)
        self.register_buffer("channel", torch.tensor(channel))  # detectors are known by their tensors and source
        self.gain = torch.nn.Parameter(torch.tensor(30.0))
        self.source = {"glow": "of these tests"}  # results of a detector that nobody knows are not kept
        self.freeze()

    def forward(self, images: Tensor) -> Detections:
        count, _, height, width = images.shape
        middle = images[:, int(self.channel), height // 5 : 4 * height // 5, 2 * width // 5 : 3 * width // 5]
        score = torch.sigmoid((middle.flatten(1).mean(1) - 0.4) * self.gain)[:, None]
        box = torch.tensor([0.3 * width, 0.1 * height, 0.7 * width, 0.9 * height])
        return Detections(box.expand(count, 1, 4), score, score, torch.ones(count, 1, dtype=torch.bool))


def make_split() -> DataSplit:
    return DataSplit(
        sample_bodies("train").select_poses([0, 9]),
        sample_bodies("unseen").select_poses([0, 3]),
        load_backgrounds("procedural:train:4"),
        load_backgrounds("procedural:test:4"),
        {"red:a.cfg": Glow("red", 0), "blue:b.cfg": Glow("blue", 2)},
    )


def make_options(out: Path, **changes: object) -> Options:
    return replace(
        Options(out=out, quick=True, steps=(2,), batch=2, images_per_view=1, size=48, samples=1, seeds=2), **changes
    )


# --- a robustness card

TINY = Size("tiny", 2, 1, 10, 180, 1, 6, 4, 3, 2, areas=(0.05, 0.76), pixels=48)


class Bulb(Glow):
    """A person is what is bright in the middle."""

    def __init__(self, name: str, differentiable: bool = True) -> None:
        super().__init__(name, 0)
        self.differentiable, self.operating_point = differentiable, 0.25


def make_store(out: Path, detector: Detector) -> RunStore:
    split = replace(make_split(), detectors={detector.spec: detector})
    return RunStore(split, StoreOptions(out=out, batch=2, size=TINY.pixels, samples=1, seeds=1), lambda _: None)
