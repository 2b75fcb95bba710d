"""From a spec to a student: which families can be hardened."""

from __future__ import annotations

import torch

from cloak_core.core.detector.protocol import Detector
from cloak_core.detectors.families import FAMILIES
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.onnx_family.detector import OnnxDetector
from cloak_core.detectors.onnx_family.weights import NotTrainable
from cloak_core.detectors.specs import parse_spec
from cloak_core.files.errors import InputError
from cloak_core.studies.hardening.student import Student

TRAINABLE = ("builtin", "darknet", "onnx", "python", "torchvision", "ultralytics")
SOURCE = "harden the weights that it was exported from (a .pt or .pth), export those, and assess both"
"""What to do with a file whose weights cannot be trained."""


def open_student(spec: str, device: str | torch.device = "cpu") -> Student:
    """A detector that is to learn. InputError: one that cannot be read, or whose weights are not in reach."""
    family = parse_spec(spec).family
    if family not in TRAINABLE:
        if family not in FAMILIES:
            load_detector(spec, device=device)  # refuses it, with the spec that was meant
        known = f"{', '.join(TRAINABLE[:-1])} and {TRAINABLE[-1]}"
        raise InputError(f"harden {spec}: cannot train {family!r}, only {known}; {SOURCE}")
    try:
        detector = load_detector(spec, device=device, fold=False)
        if isinstance(detector, OnnxDetector):
            detector.weights.check(detector.path)
    except NotTrainable as error:
        raise InputError(f"harden {error}; {SOURCE}") from None
    return _student(family, spec, detector, load_detector(spec, device=device))


def _student(family: str, spec: str, detector: Detector, teacher: Detector) -> Student:
    if family == "torchvision":
        from cloak_core.detectors.torchvision_family.dense import DenseDetector
        from cloak_core.studies.hardening.torchvision_student import DenseStudent, TwoStageStudent

        kind = DenseStudent if isinstance(detector, DenseDetector) else TwoStageStudent
        return kind(detector, teacher, spec)
    if family == "ultralytics":
        from cloak_core.studies.hardening.ultralytics_student import UltralyticsStudent

        return UltralyticsStudent(detector, teacher, spec)
    if family == "onnx":
        from cloak_core.studies.hardening.onnx_student import OnnxStudent

        return OnnxStudent(detector, teacher, spec)
    if family == "python":
        from cloak_core.studies.hardening.python_student import PythonStudent

        return PythonStudent(detector, teacher, spec)
    from cloak_core.studies.hardening.darknet_student import DarknetStudent

    return DarknetStudent(detector, teacher, spec)
