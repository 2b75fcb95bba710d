"""A small student, and what it takes to harden it."""

from pathlib import Path

from cloak_core.studies.hardening.folder import Material
from cloak_core.studies.hardening.hardening import HardenResult, harden
from cloak_core.studies.hardening.settings import HardenSettings
from cloak_core.studies.hardening.student import Student
from tests.core.fakes import box_bodies, noise_backgrounds

FEW = {
    "steps": 4,
    "batch": 2,
    "pictures": 1,
    "decoys": 1,
    "attack_steps": 1,
    "size": 64,
}


def hardened(student: Student, out: Path, resume: bool = False, **changes: object) -> HardenResult:
    settings = HardenSettings(**(FEW | changes))
    return harden(settings, student, Material(box_bodies(), noise_backgrounds()), out, resume=resume)
