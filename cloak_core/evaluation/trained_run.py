"""Read a run that training left: its record, and what was kept back from it."""

from __future__ import annotations

from pathlib import Path

from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.scene.selection import split_selection

EMBEDDED = ("sample", "sample-clothed", "sample-tight", "procedural")
COUNTERPART = {":train": {"scene": ":unseen", "backgrounds": ":test"}}
"""What was kept back from training on embedded material."""


def read_run(folder: Path) -> dict:
    """Read a run's config.json; InputError when this is no finished run."""
    if not folder.is_dir():
        raise InputError(f"{folder}: {'not a folder' if folder.exists() else 'no such folder'}")
    if not (folder / "config.json").exists():
        raise InputError(f"{folder}: not a run folder (no config.json in it)")
    if not (folder / "colors.npy").exists():
        raise InputError(f"{folder}: has no trained colours yet (no colors.npy in it)")
    config = read_json(folder / "config.json")
    inputs, detectors = config.get("inputs", {}), config.get("detectors")
    if not isinstance(inputs, dict) or not all(isinstance(value, str) for value in inputs.values()):
        raise InputError(f"{folder / 'config.json'}: inputs is not a record of names")
    if not isinstance(detectors, list) or not all(
        isinstance(d, dict) and isinstance(d.get("spec"), str) for d in detectors
    ):
        raise InputError(f"{folder / 'config.json'}: detectors is not a list of records, each with its spec")
    return config


def kept_back(kind: str, config: dict) -> str:
    """Name the embedded material that training did not see; InputError for anything else, which the user must name."""
    inputs = config.get("inputs", {})
    made_from = inputs.get("made_from", "") if kind == "scene" else ""
    spec, _ = split_selection(made_from or inputs.get(kind, ""))
    head, mark, rest = spec.partition(":train")
    if mark and head in EMBEDDED:
        return head + COUNTERPART[":train"][kind] + rest
    raise InputError(f"--{kind}: say what to evaluate on (training saw {spec or 'something unrecorded'})")
