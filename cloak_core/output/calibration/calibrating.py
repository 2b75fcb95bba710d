"""From what was measured to a profile's file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cloak_core.exchange.profiles import Profile, write_profile
from cloak_core.files.errors import InputError
from cloak_core.output.calibration.chart import patch_colors
from cloak_core.output.calibration.fitting import fit_profile
from cloak_core.output.calibration.measured import read_icc, read_patches
from cloak_core.output.calibration.photograph import read_photograph


def profile_of(measured: Sequence[Path], out: Path) -> Profile:
    """Make the profile of photographs and CSVs of patches (all together), or of one ICC profile; write it to `out`.

    `figures` say what it is worth: mean CIEDE2000 between what was sent and seen, and between what the profile
    foretells and was seen of patches that its fit was not shown (none are needed for ICC: 0).
    """
    if out.suffix != ".npz":
        raise InputError(f"--out {out}: a profile is a .npz")
    printers = [path for path in measured if path.suffix.lower() in (".icc", ".icm")]
    if printers and len(measured) > 1:
        raise InputError(f"--measured {printers[0]}: an ICC profile stands alone")
    if printers:
        profile = read_icc(printers[0])
    else:
        tables = [read_patches(path) for path in measured if path.suffix.lower() == ".csv"]
        photographs = [read_photograph(path) for path in measured if path.suffix.lower() != ".csv"]
        if photographs:
            tables.append((patch_colors(), np.mean(photographs, axis=0)))
        profile = fit_profile(*(np.concatenate(column) for column in zip(*tables, strict=True)))
    write_profile(out, profile)
    return profile
