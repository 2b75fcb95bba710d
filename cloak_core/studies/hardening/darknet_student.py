"""Darknet's networks as students: region and yolo heads, by the terms of YOLO's own loss."""

from __future__ import annotations

from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cloak_core.detectors import builtin
from cloak_core.detectors.classes import names_beside
from cloak_core.detectors.darknet.cfg import read_cfg_text
from cloak_core.detectors.darknet.detector import DarknetDetector
from cloak_core.detectors.darknet.layers import BatchNorm
from cloak_core.detectors.darknet.weights import write_darknet
from cloak_core.detectors.pixels import fit
from cloak_core.files.writing import write_text
from cloak_core.studies.hardening.distillation import distance
from cloak_core.studies.hardening.student import Student


class DarknetStudent(Student):
    """The built-in detector or any .cfg and .weights."""

    files = (".cfg", ".weights")
    lr = 1e-3
    detector: DarknetDetector
    teacher: DarknetDetector

    def __init__(self, detector: DarknetDetector, teacher: DarknetDetector, spec: str) -> None:
        super().__init__(detector, teacher, spec)
        _usual_epsilon(detector.network)
        detector.network.to(memory_format=torch.channels_last)  # twice as fast to learn, most of it in max pooling
        detector.memory_format = torch.channels_last
        own = self.request.family == "builtin"
        cfg = builtin.CFG if own else Path(self.request.parts[0]).expanduser()
        self.cfg = read_cfg_text(cfg)
        self.class_names = () if own else names_beside(cfg, teacher.network.heads[0].classes) or ()
        """Where a file beside the cfg says them; none where their number does."""

    def answer(self, detector: DarknetDetector, images: Float[Tensor, "B 3 H W"]) -> list[Float[Tensor, "B _ _ _"]]:
        inputs, _ = fit(images, detector.network.input_size, detector.letterbox)
        with self.autocast(images):
            return detector.network(inputs.contiguous(memory_format=detector.memory_format))

    def compare(
        self,
        said: list[Float[Tensor, "B _ _ _"]],
        wanted: list[Float[Tensor, "B _ _ _"]],
        surer: Bool[Tensor, " B"] | None,
        sure: float,
    ) -> Float[Tensor, " B"]:
        own = self.detector
        return distance(own.network.heads, said, wanted, own.person, surer, sure, own.operating_point)

    def save(self, stem: Path, seen: int) -> str:
        write_darknet(self.cfg, self.network, stem, seen)
        if self.class_names:
            write_text(stem.with_suffix(".names"), "\n".join(self.class_names) + "\n")
        if self.request.family == "builtin":
            return f"builtin:{stem}.weights{self.options}"
        return f"darknet:{stem}.cfg:{stem}.weights{self.options}"


@torch.no_grad()
def _usual_epsilon(network: nn.Module) -> None:
    """Batch norm of the original Darknet's files adds its epsilon outside the root; what we write adds it inside, so
    that the scale takes up the difference."""
    for norm in network.modules():
        if isinstance(norm, BatchNorm) and norm.epsilon_outside:
            scale, _ = norm.scale_and_shift()
            norm.weight.copy_(scale * (norm.running_var.double() + norm.eps).sqrt())
            norm.epsilon_outside = False
