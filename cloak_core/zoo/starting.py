"""Colours of earlier runs, which a training begins with or stays near."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float32

from cloak_core.core.logo import Logo
from cloak_core.core.run_folder import RunFolder
from cloak_core.exchange.colors import read_colors
from cloak_core.exchange.face_lists import read_face_list
from cloak_core.files.errors import InputError
from cloak_core.zoo.entry import run_path


def read_start(path: Path, logo: Logo, option: str = "--init") -> Float32[np.ndarray, "L 3"]:
    """Read colours [L, 3] to begin with: a file of them, or a run (or zoo:NAME) of the same logo. InputError."""
    path = run_path(path)
    if not path.is_dir():
        return read_colors(path, len(logo.face_ids))
    run = RunFolder(path)
    if not run.config.exists():
        raise InputError(f"{option} {path}: not a run folder (no config.json in it)")
    trained = read_face_list(run.logo)
    if trained.topology != logo.topology or not np.array_equal(trained.ids, logo.face_ids):
        raise InputError(f"{option} {path}: was trained on another logo (`cloak logo transfer` carries colours over)")
    return read_colors(run.colors, len(logo.face_ids))
