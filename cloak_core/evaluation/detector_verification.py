"""Verify detectors by their specs, on photographs and on renders of the size that each of them takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from jaxtyping import UInt8
from torch import Tensor

from cloak_core.detectors.check import read_image
from cloak_core.detectors.protocol import Detector
from cloak_core.detectors.verification.kit import framed, natural_size, verify
from cloak_core.evaluation.clean import as_bytes, clean_renders
from cloak_core.files.errors import InputError
from cloak_core.scene.backdrops.backgrounds import SUFFIXES


def verify_specs(
    specs: Sequence[str],
    load: Callable[[str], Detector],
    folder: Path | None = None,
    renders: int = 4,
    original: Detector | None = None,
) -> dict[str, dict]:
    """Run `verify` for each spec on the folder's pictures and on renders of the sample bodies; return the reports.

    original: a detector that all of them must agree with; None for the one that `verify` finds.
    """
    reports = {}
    for spec in specs:
        detector = load(spec)
        reports[spec] = verify(detector, sample_images(natural_size(detector), folder, renders), original)
    return reports


def sample_images(size: tuple[int, int], folder: Path | None, renders: int) -> UInt8[Tensor, "B 3 H W"]:
    """Collect photographs, letterboxed, then renders. InputError: no pictures in the folder."""
    rendered = clean_renders(renders, size)
    if folder is None:
        return rendered
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    files = [
        path for path in sorted(folder.iterdir()) if path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
    ]
    if not files:
        raise InputError(f"{folder}: holds no pictures ({', '.join(SUFFIXES)})")
    return torch.cat([torch.stack([as_bytes(framed(read_image(path), size)) for path in files]), rendered])
