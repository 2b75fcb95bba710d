"""What can be hardened: a detector whose parameters learn, the same before it learned anything, and a file of it.

Batch norm stays unfolded, so that what is written fits the network's own cfg, and keeps its running statistics: they
are those of the photographs that it was trained on, and cloaks must not move them. Its scale and shift learn. So the
network that is attacked while it learns is the network that will be used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cloak_core.defend.distillation import distance
from cloak_core.detectors import builtin
from cloak_core.detectors.classes import names_beside
from cloak_core.detectors.darknet.cfg import read_cfg_text
from cloak_core.detectors.darknet.detector import DarknetDetector
from cloak_core.detectors.darknet.layers import BatchNorm
from cloak_core.detectors.darknet.weights import write_darknet
from cloak_core.detectors.families import FAMILIES
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.resizing import fit
from cloak_core.detectors.specs import parse_spec
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_text

NAME = "hardened"
TRAINABLE = ("builtin", "darknet")


@dataclass(eq=False)
class Student:
    """A Darknet network that learns, and its teacher: what it was."""

    detector: DarknetDetector
    teacher: DarknetDetector
    spec: str
    """Of what it was made from."""
    cfg: str
    class_names: tuple[str, ...]
    """Of its classes, where a file beside the cfg says them; none where their number does."""
    named: Callable[[Path], str] = field(repr=False)
    """The spec of a written copy, from its path without ending."""

    @property
    def network(self) -> nn.Module:
        return self.detector.network

    def maps(self, detector: DarknetDetector, images: Float[Tensor, "B 3 H W"]) -> list[Float[Tensor, "B _ _ _"]]:
        """What a detector's heads say of images, before any activation."""
        inputs, _ = fit(images, detector.network.input_size, detector.letterbox)
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.detector.precision == "bfloat16"):
            return detector.network(inputs.contiguous(memory_format=detector.memory_format))

    def distance(
        self,
        images: Float[Tensor, "B 3 H W"],
        wanted: list[Float[Tensor, "B _ _ _"]],
        surer: Bool[Tensor, B] | None = None,
        sure: float = 0.0,
    ) -> Float[Tensor, B]:
        """How far the student's answers are from `wanted`, the teacher's; see `distillation.distance`."""
        own = self.detector
        said = self.maps(own, images)
        return distance(own.network.heads, said, wanted, own.person, surer, sure, own.operating_point)

    def write(self, state: dict[str, Tensor], folder: Path, seen: int) -> str:
        """Write a state of the network into `folder`, with its licence; returns the spec that loads it."""
        before = {name: tensor.clone() for name, tensor in self.network.state_dict().items()}
        try:
            self.network.load_state_dict(state)
            write_darknet(self.cfg, self.network, folder / NAME, seen)
            if self.class_names:
                write_text(folder / f"{NAME}.names", "\n".join(self.class_names) + "\n")
        finally:
            self.network.load_state_dict(before)
        spec = self.named(folder / NAME)
        write_text(folder / f"{NAME}.licence.txt", self._licence(spec))
        return spec

    def _licence(self, spec: str) -> str:
        family = FAMILIES[parse_spec(self.spec).family]
        return (
            f"{NAME}.cfg and {NAME}.weights were made from the detector {self.spec} by `cloak harden`.\n"
            f"Their licence is that of what they were made from: {family.licence}.\n"
            f"Load them as {spec}\n"
        )


def open_student(spec: str, device: str | torch.device = "cpu") -> Student:
    """A detector that is to learn. InputError: one that cannot be read, or of a family that nobody trains here."""
    request = parse_spec(spec)
    if request.family not in TRAINABLE:
        known = " and ".join(TRAINABLE)
        raise InputError(f"harden {spec}: cannot train {request.family!r} yet, only {known}")
    detector, teacher = load_detector(spec, device=device, fold=False), load_detector(spec, device=device)
    _usual_epsilon(detector.network)
    detector.network.to(memory_format=torch.channels_last)  # twice as fast to learn, most of it in max pooling
    detector.memory_format = torch.channels_last
    options = spec.rpartition("@")[2] if spec != f"{request.family}:{request.what}".rstrip(":") else ""
    options = f"@{options}" if options else ""
    if request.family == "builtin":
        cfg, named = builtin.CFG, lambda stem: f"builtin:{stem}.weights{options}"
    else:
        cfg, named = Path(request.parts[0]).expanduser(), lambda stem: f"darknet:{stem}.cfg:{stem}.weights{options}"
    names = () if request.family == "builtin" else names_beside(cfg, teacher.network.heads[0].classes) or ()
    return Student(detector, teacher, spec, read_cfg_text(cfg), names, named)


@torch.no_grad()
def _usual_epsilon(network: nn.Module) -> None:
    """Batch norm of the original Darknet's files adds its epsilon outside the root; what we write adds it inside, so
    that the scale takes up the difference."""
    for norm in network.modules():
        if isinstance(norm, BatchNorm) and norm.epsilon_outside:
            scale, _ = norm.scale_and_shift()
            norm.weight.copy_(scale * (norm.running_var.double() + norm.eps).sqrt())
            norm.epsilon_outside = False
