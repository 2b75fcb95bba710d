"""`cloak train --extend N`: a run that is complete goes on in a folder of its own, from its last checkpoint."""

from __future__ import annotations

import shutil
from pathlib import Path

from cloak_core.core.checkpoints import load_checkpoint
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.writing import new_folder, write_json, written

KEPT = (
    *("material.npz", "logo.npy", "logo.json", "colors.npy", "cloth.png", "events.jsonl"),
    *("checkpoint", "previews", "snapshots"),
)
"""Of a run: what training wrote; what was made of it is made again."""


def extended(run: Path, updates: int) -> tuple[Path, int]:
    """Copy a run into RUN-STEPS, its settings asking for `updates` more; return that folder and STEPS.

    Where it is there already, from an earlier --extend, it is the one that goes on. InputError: no run, or none that
    has a checkpoint; no update more.
    """
    if updates < 1:
        raise InputError(f"--extend {updates}: some updates more are needed")
    if not (run / "config.json").is_file():
        raise InputError(f"{run}: no run to extend (--out names the one that is complete)")
    checkpoint, _ = load_checkpoint(run / "checkpoint")
    if checkpoint is None:
        raise InputError(f"{run}: has no checkpoint to go on from")
    steps = checkpoint.step + updates
    out = run.with_name(f"{run.name}-{steps}")
    if not out.exists():
        config = read_json(run / "config.json")
        config["settings"] = config["settings"] | {"steps": steps, "epochs": None}
        with new_folder(out) as folder, written(folder):
            for part in KEPT:
                if (run / part).is_dir():
                    shutil.copytree(run / part, folder / part)
                elif (run / part).is_file():
                    shutil.copy(run / part, folder / part)
            write_json(folder / "config.json", config)
    return out, steps
