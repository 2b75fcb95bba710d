"""Anyone's own detector as a student: all parameters of its module learn, from what it says of every box."""

from __future__ import annotations

from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cloak_core.detectors.python_module import PythonDetector
from cloak_core.files.errors import InputError
from cloak_core.files.writing import replace_file, write_text
from cloak_core.studies.hardening.answers import Answer, answer_of, score_distance
from cloak_core.studies.hardening.student import NAME, Student

LOADER = '''"""{function}() of {file} with the hardened weights beside this file."""

import importlib.util
from pathlib import Path

import torch

WEIGHTS = Path(__file__).parent / "{weights}"
MODULE = {file!r}


def {function}() -> torch.nn.Module:
    """Make the network and load the hardened weights into it."""
    spec = importlib.util.spec_from_file_location("unhardened", MODULE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    network = module.{function}()
    network.load_state_dict(torch.load(WEIGHTS, weights_only=True))
    return network
'''


class PythonStudent(Student):
    """A torch module that answers the same boxes in the same order whatever its weights are.

    InputError: another runtime runs it, or no gradient reaches its parameters.
    """

    files = (".py", ".pth")
    detector: PythonDetector
    teacher: PythonDetector

    def __init__(self, detector: PythonDetector, teacher: PythonDetector, spec: str) -> None:
        super().__init__(detector, teacher, spec)
        parameters = list(detector.module.parameters())
        if not detector.differentiable or not parameters:
            raise InputError(f"harden {spec}: its module has no parameters that torch could train")
        side = max(detector.input_size or (64, 64))
        detector.requires_grad_(True)
        with torch.enable_grad():
            scores = detector.detect(torch.rand(1, 3, side, side, device=detector.device)).scores
        detector.requires_grad_(False)
        if not scores.requires_grad:
            raise InputError(f"harden {spec}: no gradient of its scores reaches its parameters")

    @property
    def network(self) -> nn.Module:
        return self.detector.module

    def answer(self, detector: PythonDetector, images: Float[Tensor, "B 3 H W"]) -> Answer:
        # The teacher's precision is its own.
        half = detector.precision == "bfloat16"
        with torch.autocast(images.device.type, torch.bfloat16, enabled=half):
            found = detector.detect(images)
        scores = found.scores.unsqueeze(-1)
        if found.other is not None:
            scores = torch.stack([found.scores, found.other], dim=-1)
        return answer_of(scores, found.boxes)

    def compare(
        self, said: Answer, wanted: Answer, surer: Bool[Tensor, " B"] | None, sure: float
    ) -> Float[Tensor, " B"]:
        if said.boxes.shape != wanted.boxes.shape:
            raise InputError(
                f"harden {self.spec}: answers other numbers of boxes for other weights; return them all, unsuppressed"
            )
        return score_distance(said, wanted, 0, self.detector.operating_point, surer, sure)

    def save(self, stem: Path, seen: int) -> str:
        file, function = self.request.parts
        weights = {name: value.detach().cpu().contiguous() for name, value in self.network.state_dict().items()}
        replace_file(stem.with_suffix(".pth"), lambda stream: torch.save(weights, stream))
        path = str(Path(file).expanduser().absolute())
        write_text(stem.with_suffix(".py"), LOADER.format(function=function, file=path, weights=f"{NAME}.pth"))
        return f"python:{stem.with_suffix('.py')}:{function}{self.options}"
