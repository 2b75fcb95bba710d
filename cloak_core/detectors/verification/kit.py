"""All checks on one detector, as a report."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from cloak_core.core.detector.protocol import Detector, state_hash
from cloak_core.detectors.families import FAMILIES
from cloak_core.detectors.loading import load_detector
from cloak_core.detectors.pixels import fit
from cloak_core.detectors.verification import checks
from cloak_core.detectors.verification.checks import Finding, Images, Subject
from cloak_core.detectors.verification.comparing import BATCH, sample_images
from cloak_core.files.errors import first_line

SIDE = 416
"""Of images for detectors that take any size."""
CHECKS: dict[str, Callable[[Subject], Finding]] = {
    "shapes": checks.shapes,
    "scores in [0, 1]": checks.ranges,
    "boxes": checks.sane_boxes,
    "repeatable": checks.repeatable,
    "batch invariance": checks.batch_invariance,
    "black, white, noise": checks.extremes,
    "gradient": checks.gradient,
    "descent": checks.descent,
    "parity": checks.parity,
    "another size": checks.other_size,
    "speed": checks.speed,
}
KEYS = ("parity_scores", "parity_boxes_px", "gradient_error", "batch_invariant", "forward_ratio")
"""Figures that every report has, None where a check did not get so far."""
_log = logging.getLogger("cloak")


def verify(
    detector: Detector,
    images: Images | None = None,
    original: Detector | None = None,
    on_check: Callable[[], None] = lambda: None,
) -> dict[str, object]:
    """Check a detector on images of one size, in [0, 1] or bytes, photographs first; without any, on procedural scenes.

    original: what to compare it with; None for what `original_of` finds. on_check: called after each check. Returns
    {"spec", "layout" (of an ONNX file's outputs, else the family), "white_box": it has gradients, "opset" of an ONNX
    file, "untranslated": {"op", "version", "node"} of its operators that made it a black box, "parity_scores" and
    "parity_boxes_px": largest differences from the original, "gradient_error": relative, against a finite difference,
    "batch_invariant", "forward_ratio": time beside the original's, "operating_point", "operating_point_assumed",
    "person_class": its index, "failed": names of the checks that failed, "images": how many, "checks": {NAME:
    {"passed", "words"}}}; None where there is nothing to compare with or to differentiate. What the detector raises
    fails the check that met it, and ends them.
    """
    images = sample_images(natural_size(detector)) if images is None else images
    images = torch.cat([images] * -(-BATCH // len(images)))[: max(BATCH, len(images))]
    subject = Subject(detector, images, original or original_of(detector))
    before = state_hash(detector)

    def state(subject: Subject) -> Finding:
        same = state_hash(subject.detector) == before
        return Finding(same, "unchanged, bit by bit" if same else "its parameters, buffers or train flags changed")

    findings = _in_turn(CHECKS | {"state": state}, subject, on_check)
    figures = {key: value for finding in findings.values() for key, value in finding.figures.items()}
    family = detector.spec.partition(":")[0].partition("@")[0]
    return {
        "spec": detector.spec,
        "layout": detector.source.get("layout", family),
        "white_box": detector.differentiable,
        "opset": getattr(detector, "opset", None),
        "untranslated": list(getattr(detector, "untranslated", ())),
        **(dict.fromkeys(KEYS) | figures),
        "operating_point": detector.operating_point,
        "operating_point_assumed": detector.operating_point_assumed,
        "person_class": getattr(detector, "person", None),
        "images": len(images),
        "checks": {name: {"passed": f.passed, "words": f.words} for name, f in findings.items()},
        "failed": [name for name, finding in findings.items() if finding.passed is False],
    }


def original_of(detector: Detector) -> Detector | None:
    """Load the same network in the runtime that its file was made for, else as it was trained.

    The latter where a family changes what it loads (batch norm folded, memory laid out anew); None where neither is to
    be had.
    """
    own = detector.original()
    family = FAMILIES.get(detector.spec.partition(":")[0].partition("@")[0])
    if own is not None or family is None or not family.changes_networks:
        return own
    return load_detector(detector.spec, device=detector.device, fold=False)


def natural_size(detector: Detector) -> tuple[int, int]:
    """Give (height, width) of the images that it takes without resizing them, as far as it says."""
    size = detector.source.get("input_size")
    return tuple(size) if size else (SIDE, SIDE)


def framed(picture: Float[Tensor, "3 H W"], size: tuple[int, int]) -> Float[Tensor, "3 h w"]:
    """Fit a picture of any size into an image of this one, its aspect ratio kept."""
    return fit(picture[None], size, letterbox=True)[0][0]


def _in_turn(
    checks: Mapping[str, Callable[[Subject], Finding]], subject: Subject, on_check: Callable[[], None]
) -> dict[str, Finding]:
    """Run each check; after the first that the detector answers with an error or a wrong shape, skip the rest.

    They would only meet the same cause again.
    """
    findings: dict[str, Finding] = {}
    cause = ""
    for name, check in checks.items():
        if cause:
            findings[name] = Finding(None, f"not asked: {cause} failed")
            continue
        try:
            findings[name] = check(subject)
            cause = name if name == "shapes" and findings[name].passed is False else ""
        except (MemoryError, torch.OutOfMemoryError):
            raise
        except Exception as error:  # anything that a wrapper raises is one of the ways in which it fails
            _log.info("%s", subject.detector.spec, exc_info=error)
            findings[name] = Finding(False, f"{type(error).__name__}: {first_line(error)[:200]}")
            cause = name
        on_check()
    return findings
