"""What a run needs to go on bit-identically, on disk: complete or absent, never half.

`checkpoint/step-00000100/` holds `state.safetensors` (colours and the optimiser's state) and `state.json` (step, time,
and the SHA-256 of the former). It is written under another name, flushed, and renamed; the last two are kept, so that a
damaged one leaves its predecessor. Random numbers need no state: they derive from (seed, step).
"""

import hashlib
import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from cloak_core.exchange.checks import FORMAT_VERSION
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_bytes, read_json
from cloak_core.files.writing import new_folder, write_bytes, write_json, written

KEPT = 2
MAX_BYTES = 1 << 30
_NAME = re.compile(r"step-(\d{8,})")


@dataclass(frozen=True)
class Checkpoint:
    """The state after `step` updates."""

    step: int
    time: float
    """Seconds of training so far."""
    tensors: dict[str, Tensor]
    """On the CPU."""


def save_checkpoint(folder: Path, checkpoint: Checkpoint) -> None:
    """Write into `folder` (the run's `checkpoint/`) and let the oldest beyond two go. InputError when it cannot."""
    data = save({name: tensor.detach().cpu().contiguous() for name, tensor in checkpoint.tensors.items()})
    record = {
        "format": "cloak checkpoint",
        "version": FORMAT_VERSION,
        "step": checkpoint.step,
        "time": checkpoint.time,
        "sha256": hashlib.sha256(data).hexdigest(),
    }
    target = folder / f"step-{checkpoint.step:08d}"
    with written(target):
        if target.exists():  # the same step again, after a resume that found it damaged
            shutil.rmtree(target)
        with new_folder(target) as temporary:
            write_bytes(temporary / "state.safetensors", data)
            write_json(temporary / "state.json", record)
        if os.name == "posix":  # elsewhere a folder cannot be opened; the rename is as durable as it gets
            handle = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
        for path in _checkpoints(folder)[:-KEPT]:
            shutil.rmtree(path)


def load_checkpoint(folder: Path) -> tuple[Checkpoint | None, list[str]]:
    """Load the latest sound checkpoint in `folder`, None where there is none; list what is wrong with others."""
    damaged = []
    for path in reversed(_checkpoints(folder)):
        try:
            return _read(path), damaged
        except InputError as error:
            damaged.append(str(error))
    return None, damaged


def send_checkpoint(checkpoint: Checkpoint | None) -> bytes:
    """Serialise a checkpoint for another process; empty for none."""
    if checkpoint is None:
        return b""
    place = {
        "run.step": torch.tensor(checkpoint.step),
        "run.time": torch.tensor(checkpoint.time, dtype=torch.float64),
    }
    return save({**checkpoint.tensors, **place})


def receive_checkpoint(data: bytes) -> Checkpoint | None:
    """Read what `send_checkpoint` sent."""
    if not data:
        return None
    tensors = load(data)
    return Checkpoint(int(tensors.pop("run.step")), float(tensors.pop("run.time")), tensors)


def remove_unfinished(folder: Path) -> None:
    """Remove what a killed process left unfinished in `folder`."""
    for path in folder.glob(".step-*"):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)


def _checkpoints(folder: Path) -> list[Path]:
    folders = [path for path in folder.glob("step-*") if _NAME.fullmatch(path.name)]
    return sorted(folders, key=lambda path: int(path.name[5:]))


def _read(path: Path) -> Checkpoint:
    record = read_json(path / "state.json")
    step, time = record.get("step"), record.get("time")
    if record.get("format") != "cloak checkpoint" or not isinstance(record.get("version"), int):
        raise InputError(f"{path}: not a checkpoint of Cloak")
    if record["version"] > FORMAT_VERSION:
        raise InputError(f"{path}: version {record['version']} is newer than this Cloak reads ({FORMAT_VERSION})")
    if not isinstance(step, int) or not isinstance(time, (int, float)) or path.name != f"step-{step:08d}":
        raise InputError(f"{path}: its record does not fit its name")
    file = path / "state.safetensors"
    data = read_bytes(file, MAX_BYTES)
    if hashlib.sha256(data).hexdigest() != record.get("sha256"):
        raise InputError(f"{file}: torn or changed (its SHA-256 is not the recorded one)")
    try:
        tensors = load(data)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: not readable as safetensors ({error})") from None
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise InputError(f"{file}: '{name}' is not finite")
    return Checkpoint(step, float(time), tensors)
