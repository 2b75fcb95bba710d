"""What hardening needs of a detector, whatever its family: a network that learns, what it was before, a file of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from cloak_core.detectors.families import FAMILIES
from cloak_core.detectors.specs import parse_spec
from cloak_core.files.writing import write_text
from cloak_core.studies.hardening.answers import Answer, Maps, Reading, Stages, Surer

NAME = "hardened"
TRAINABLE = ("builtin", "darknet", "onnx", "python", "torchvision", "ultralytics")
"""Families that can be hardened."""


class Student(ABC):
    """A detector that learns, and its teacher: what it was.

    Batch norm stays unfolded, so that what is written fits the family's own files, and keeps its running statistics
    (the network is always in eval mode): they are those of the photographs that it was trained on, and cloaks must not
    move them. Its scale and shift learn. So the network that is attacked while it learns is the one that will be used.

    A family says how its networks answer, and how a network is written.
    """

    files: ClassVar[tuple[str, ...]]
    """Endings of what `write` writes beside the licence."""
    lr: ClassVar[float] = 1e-4
    """Learning rate where the settings say none. NanoDet-m forgot what it knew at 2e-4, YOLOv5n at 3e-4."""

    corners: ClassVar[bool] = False
    """Its boxes are corners in pixels (`Reading.corners`)."""

    def __init__(self, detector: Any, teacher: Any, spec: str) -> None:
        self.detector, self.teacher, self.spec = detector, teacher, spec
        self.request = parse_spec(spec)
        options = spec.rpartition("@")[2] if spec != f"{self.request.family}:{self.request.what}".rstrip(":") else ""
        self.options = f"@{options}" if options else ""
        # What a module of the user's answers is of the person alone.
        person = getattr(detector, "person", 0)
        self.reading = Reading(person=person, found_at=detector.operating_point, corners=self.corners)

    @property
    def network(self) -> nn.Module:
        """What learns and is written."""
        return self.detector.network

    @property
    def licence(self) -> str:
        """Of what is hardened, as far as that is known."""
        return FAMILIES[self.request.family].licence

    @abstractmethod
    def answer(self, detector: Any, images: Float[Tensor, "B 3 H W"]) -> Answer | Maps | Stages:
        """Ask the student's or the teacher's network about images."""

    def matched(self, answer: Any, wanted: Any) -> Any:
        """Put the answer wanted into the order of the student's, where the two may differ."""
        return wanted

    @abstractmethod
    def save(self, stem: Path, seen: int) -> str:
        """Write the network as it is into `stem` and the endings in `files`; returns the spec that loads it. seen: how
        many images it learned from, for formats that say that."""

    @torch.no_grad()
    def wanted(self, images: Float[Tensor, "P 3 H W"], rows: Int[Tensor, " B"]) -> Any:
        """Ask the teacher, for `distance`: its k-th image is to be answered as images[rows[k]] is."""
        return self.answer(self.teacher, images).of(rows)

    def distance(
        self, images: Float[Tensor, "B 3 H W"], wanted: Any, surer: Surer | None = None
    ) -> Float[Tensor, " B"]:
        """Measure how far the student's answers are from those wanted; 0 where they are equal, and nothing is surer."""
        answer = self.answer(self.detector, images)
        return answer.distance(self.matched(answer, wanted), self.reading, surer)

    def autocast(self, images: Float[Tensor, "B 3 H W"]) -> torch.autocast:
        """Make the context in which either network is run: half precision where the student learns in it."""
        return torch.autocast(images.device.type, torch.bfloat16, enabled=self.detector.precision == "bfloat16")

    def write(self, state: dict[str, Tensor], folder: Path, seen: int) -> str:
        """Write a state of the network into `folder`, with its licence; returns the spec that loads it."""
        before = {name: tensor.clone() for name, tensor in self.network.state_dict().items()}
        try:
            self.network.load_state_dict(state)
            spec = self.save(folder / NAME, seen)
        finally:
            self.network.load_state_dict(before)
        made = " and ".join(f"{NAME}{ending}" for ending in self.files)
        licence = (
            f"{made}: made from the detector {self.spec} by `cloak harden`.\n"
            f"The licence is that of what it was made from: {self.licence}.\n"
            f"Load it as {spec}\n"
        )
        write_text(folder / f"{NAME}.licence.txt", licence)
        return spec
