"""From a spec to a student: which families can be hardened."""

from __future__ import annotations

import torch

from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.specs import parse_spec
from cloak_core.files.errors import InputError
from cloak_core.studies.hardening.student import Student

TRAINABLE = ("builtin", "darknet", "torchvision", "ultralytics")


def open_student(spec: str, device: str | torch.device = "cpu") -> Student:
    """A detector that is to learn. InputError: one that cannot be read, or of a family that nobody trains here."""
    family = parse_spec(spec).family
    if family not in TRAINABLE:
        known = f"{', '.join(TRAINABLE[:-1])} and {TRAINABLE[-1]}"
        raise InputError(f"harden {spec}: cannot train {family!r}, only {known}")
    detector, teacher = load_detector(spec, device=device, fold=False), load_detector(spec, device=device)
    if family == "torchvision":
        from cloak_core.detectors.torchvision_family.dense import DenseDetector
        from cloak_core.studies.hardening.torchvision_student import DenseStudent, TwoStageStudent

        kind = DenseStudent if isinstance(detector, DenseDetector) else TwoStageStudent
        return kind(detector, teacher, spec)
    if family == "ultralytics":
        from cloak_core.studies.hardening.ultralytics_student import UltralyticsStudent

        return UltralyticsStudent(detector, teacher, spec)
    from cloak_core.studies.hardening.darknet_student import DarknetStudent

    return DarknetStudent(detector, teacher, spec)
