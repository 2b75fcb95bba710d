"""The folder of one training: who may write into it, what it was started with, and how it is told to stop.

config.json + material.npz  logo.npy + logo.json  events.jsonl  colors.npy  cloth.png (a cloth that repeats)
checkpoint/  previews/  snapshots/  report.html  cancel
"""

import contextlib
import logging
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32
from PIL import Image
from torch import Tensor

from cloak_core.core.checkpoints import remove_unfinished
from cloak_core.core.detector.drawing import draw_boxes
from cloak_core.core.detector.protocol import Detections
from cloak_core.core.detector.scoring import person_boxes
from cloak_core.core.logo import Logo
from cloak_core.core.pictures import save_picture
from cloak_core.core.run_config import changes_around, check_same, read_config, write_config
from cloak_core.exchange.cloth import CLOTH_FILE
from cloak_core.exchange.colors import write_colors
from cloak_core.exchange.face_lists import write_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.locks import lock
from cloak_core.files.writing import is_taken, new_folder, remove_all_leftovers, written

_log = logging.getLogger("cloak")


class RunFolder:
    """Paths of a run. Make one with `open_run`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config = path / "config.json"
        self.logo = path / "logo.npy"
        self.events = path / "events.jsonl"
        self.colors = path / "colors.npy"
        self.cloth = path / CLOTH_FILE
        self.checkpoint = path / "checkpoint"
        self.previews = path / "previews"
        self.snapshots = path / "snapshots"
        self.cancel = path / "cancel"
        self.changes: list[str] = []
        """What is not as it was when the run began, though it decides at most the last bits of the result."""

    def write_cloth(self, picture: Float32[np.ndarray, "h w 3"]) -> None:
        """Write what is to be printed, a pixel for each square."""
        _save_cloth(self.cloth, picture)

    def write_snapshot(
        self, step: int, colors: Float32[np.ndarray, "L 3"], picture: Float32[np.ndarray, "h w 3"] | None = None
    ) -> None:
        """Keep a copy of the colours after `step` steps; of a cloth also its picture, which is finer than faces."""
        if self.snapshots.is_symlink():
            raise InputError(f"{self.snapshots}: not a folder of its own")
        with written(self.snapshots):
            self.snapshots.mkdir(exist_ok=True)
        path = self.snapshots / f"step-{step:08d}.npy"
        if picture is not None:
            _save_cloth(path.with_suffix(".png"), picture)
        write_colors(path, colors)


def _save_cloth(path: Path, picture: Float32[np.ndarray, "h w 3"]) -> None:
    save_picture(path, Image.fromarray(np.round(255 * picture).astype(np.uint8)))


@contextlib.contextmanager
def open_run(path: Path, config: dict, logo: Logo, resume: bool) -> Iterator[RunFolder]:
    """Create a run folder, or open it to resume; nobody else can train in it until the block ends.

    InputError: the folder exists and is not to be resumed, was started with another configuration (the first
    difference is named), is no run folder, or is being written by another process. Resuming what does not exist yet
    starts it, so that one command serves every restart.
    """
    path = Path(path)
    if is_taken(path) and not resume:
        raise InputError(f"{path}: exists already (--resume goes on with it)")
    if not is_taken(path):
        try:
            _start(path, config, logo)
        except InputError:
            # Another process may have been quicker by a moment; whose folder it is then, is asked below.
            if not (resume and path.exists()):
                raise
    run = RunFolder(path)
    if not run.config.exists():
        raise InputError(f"{path}: not a run folder (no config.json in it)")
    with lock(path / ".lock", busy=f"{path}: another process is training in this folder"):
        recorded = read_config(path)
        check_same(recorded, config, path)
        run.changes = changes_around(recorded, config)
        if run.changes:
            began = ", ".join(run.changes)
            _log.warning("%s: began with %s: colours may differ in bits from those of an unbroken run", path, began)
        for folder in (run.checkpoint, run.previews):
            # A run folder may come from elsewhere; nothing of it may lead outside.
            if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
                raise InputError(f"{folder}: not a folder of its own")
            with written(folder):
                folder.mkdir(exist_ok=True)
        remove_unfinished(run.checkpoint)
        for folder in (path, run.previews, *[run.snapshots] * (not run.snapshots.is_symlink())):
            remove_all_leftovers(folder)
        with written(run.cancel):
            run.cancel.unlink(missing_ok=True)
        yield run


def _start(path: Path, config: dict, logo: Logo) -> None:
    with new_folder(path) as temporary:
        write_config(temporary, config)
        write_face_list(temporary / "logo.npy", logo.face_ids, logo.topology)
        (temporary / "checkpoint").mkdir()
        (temporary / "previews").mkdir()


MOST = 8
"""Images on one sheet."""


def save_preview(path: Path, images: Float[Tensor, "B 3 H W"], detections: Detections, threshold: float) -> None:
    """Save a sheet of the first images, boxes drawn around persons above `threshold`; whole or not at all."""
    count = min(len(images), MOST)
    columns = math.ceil(math.sqrt(count))
    height, width = images.shape[-2:]
    sheet = Image.new("RGB", (columns * width, math.ceil(count / columns) * height))
    boxes = person_boxes(Detections(detections.boxes[:count].detach(), detections.scores[:count].detach()), threshold)
    for i in range(count):
        sheet.paste(draw_boxes(images[i], boxes[i]), (i % columns * width, i // columns * height))
    save_picture(path, sheet)
