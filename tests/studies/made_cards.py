"""A fake detector and a tiny size: a robustness card takes seconds."""

from dataclasses import replace
from pathlib import Path

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.evaluation.settings import StoreOptions
from cloak_core.studies.card.protocol import Size
from cloak_core.studies.store import RunStore
from tests.studies import made_split

TINY = Size("tiny", 2, 1, 10, 180, 1, 6, 4, 3, 2, areas=(0.05, 0.76), pixels=48)


class Glow(made_split.Glow):
    """A person is what is bright in the middle."""

    def __init__(self, name: str, differentiable: bool = True) -> None:
        super().__init__(name, 0)
        self.differentiable, self.operating_point = differentiable, 0.25


def make_store(out: Path, detector: Detector) -> RunStore:
    split = replace(made_split.make_split(), detectors={detector.spec: detector})
    return RunStore(split, StoreOptions(out=out, batch=2, size=TINY.pixels, samples=1, seeds=1), lambda _: None)
