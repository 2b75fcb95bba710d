"""A training's events as TensorBoard shows them: scalars by step, and the preview pictures."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

from cloak_core.files.errors import InputError
from cloak_core.scene.pictures import read_picture

SHOWN = {"step": "training", "held_out": "held out"}
"""Events whose numbers become scalars, and the group they stand in."""


class TensorBoardEvents:
    """Takes a run's events and writes them into RUN/tensorboard. InputError where the package is not installed."""

    def __init__(self, run: Path) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            raise InputError("--tensorboard: needs TensorBoard: pip install 'cloak-core[tensorboard]'") from None
        self._writer_type = SummaryWriter
        self._run = run
        self._writer: SummaryWriter | None = None

    def __enter__(self) -> TensorBoardEvents:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if self._writer:
            self._writer.close()

    def __call__(self, event: dict) -> None:
        kind, step = event.get("type"), event["step"]
        if kind in ("start", "resume"):
            # Only now does the run folder exist. What an earlier part wrote of later steps is hidden.
            self._writer = self._writer_type(str(self._run / "tensorboard"), purge_step=step + 1)
        if self._writer is None:
            return
        if kind in SHOWN:
            for name, value in event.items():
                if isinstance(value, float) and name != "time":
                    self._writer.add_scalar(f"{SHOWN[kind]}/{name}", value, step)
        elif kind == "preview":
            self._add_picture(self._run / event["path"], step)

    def _add_picture(self, path: Path, step: int) -> None:
        self._writer.add_image("preview", read_picture(path), step, dataformats="HWC")
