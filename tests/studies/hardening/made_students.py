"""A small student, and what it takes to harden it."""

from pathlib import Path

import pytest
import torch

from cloak_core.core.detector.protocol import state_hash
from cloak_core.core.loop import StopRequest
from cloak_core.detectors.loading import load_detector
from cloak_core.studies.hardening.hardening import HardenMaterial, HardenResult, harden
from cloak_core.studies.hardening.settings import HardenSettings
from cloak_core.studies.hardening.student import Student
from cloak_core.studies.hardening.students import open_student
from tests.core.fakes import box_bodies, noise_backgrounds
from tests.detectors.helpers import images

FEW = {"steps": 4, "batch": 2, "pictures": 1, "decoys": 1, "attack_steps": 1, "size": 64}
FEWER = {"steps": 2, "batch": 1, "clean": 1, "pictures": 1, "attack_steps": 1, "size": 64}


def hardened(student: Student | str, out: Path, resume: bool = False, **changes: object) -> HardenResult:
    student = open_student(student) if isinstance(student, str) else student
    settings = HardenSettings(**(FEW | changes))
    return harden(settings, student, HardenMaterial(box_bodies(), noise_backgrounds()), out, resume=resume)


@torch.no_grad()
def disturb(student: Student, *names: str) -> None:
    """Move these parameters (all where none is named) a little away from the teacher's."""
    generator = torch.Generator().manual_seed(0)
    own = student.detector.weights.parameters if names else {}
    for weights in [own[name] for name in names] or student.network.parameters():
        weights += 0.05 * weights.std(correction=0) * torch.randn(weights.shape, generator=generator)


def losses_of(student: Student, shown: torch.Tensor, wanted: object) -> list[float]:
    """Follow the slope of the distance four times, each a tenth of the way down, were it linear."""
    parameters, losses = list(student.detector.requires_grad_(True).parameters()), []
    for _ in range(4):
        loss = student.distance(shown, wanted).mean()
        losses.append(float(loss.detach()))
        slopes = torch.autograd.grad(loss, parameters, allow_unused=True)
        used = [(w, slope) for w, slope in zip(parameters, slopes, strict=True) if slope is not None]
        length = 0.1 * losses[-1] / sum(float(slope.square().sum()) for _, slope in used)
        with torch.no_grad():
            for weights, slope in used:
                weights -= length * slope
    student.detector.requires_grad_(False)
    return losses


def learns(student: Student) -> None:
    rows, teacher = torch.tensor([0, 1, 0]), state_hash(student.teacher)
    batch = images(2, 64, 64)
    wanted, shown = student.wanted(batch, rows), batch[rows]
    assert float(student.distance(shown, wanted).abs().max()) < 1e-3
    disturb(student)
    losses = losses_of(student, shown, wanted)
    assert losses[-1] < 0.9 * losses[0]
    assert state_hash(student.teacher) == teacher


def check_that_a_stopped_one_goes_on(
    spec: str, folder: Path, monkeypatch: pytest.MonkeyPatch, **changes: object
) -> None:
    """To the same bits as one that is not stopped."""
    changes = FEWER | changes
    whole = hardened(spec, folder / "whole", **changes)
    with monkeypatch.context() as patched:
        patched.setattr(StopRequest, "reason", lambda *_: "cancel file")
        assert hardened(spec, folder / "part", **changes).step == 1
    rest = hardened(spec, folder / "part", resume=True, **changes)
    assert (rest.stopped, rest.step) == ("", 2)
    hashes = [state_hash(load_detector(one)) for one in (spec, whole.spec, rest.spec)]
    assert hashes[0] != hashes[1] == hashes[2]
