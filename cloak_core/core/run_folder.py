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

from cloak_core.core.detector.protocol import Detections
from cloak_core.core.detector.scoring import draw_boxes, person_boxes
from cloak_core.core.logo import Logo
from cloak_core.core.loop import LoopFolder
from cloak_core.core.pictures import save_picture
from cloak_core.core.run_config import changes_around, check_same, read_config, write_config
from cloak_core.exchange.cloth import CLOTH_FILE
from cloak_core.exchange.face_lists import write_colors, write_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.writing import remove_all_leftovers, written

_log = logging.getLogger("cloak")


class RunFolder(LoopFolder):
    """Paths of a run. Make one with `open_run`."""

    work = "training"
    folders = ("checkpoint", "previews")

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.logo = path / "logo.npy"
        self.colors = path / "colors.npy"
        self.cloth = path / CLOTH_FILE
        self.previews = path / "previews"
        self.snapshots = path / "snapshots"
        self.changes: list[str] = []
        """What is not as it was when the run began, though it decides at most the last bits of the result."""

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
            write_cloth(path.with_suffix(".png"), picture)
        write_colors(path, colors)


def write_cloth(path: Path, picture: Float32[np.ndarray, "h w 3"]) -> None:
    """Write what is to be printed, a pixel for each square."""
    save_picture(path, Image.fromarray(np.round(255 * picture).astype(np.uint8)))


@contextlib.contextmanager
def open_run(path: Path, config: dict, logo: Logo, resume: bool) -> Iterator[RunFolder]:
    """Create a run folder, or open it to resume; nobody else can train in it until the block ends.

    InputError: see `LoopFolder.opened`; it was started with another configuration (the first difference is named).
    """
    run = RunFolder(Path(path))

    def start(folder: Path) -> None:
        write_config(folder, config)
        write_face_list(folder / "logo.npy", logo.face_ids, logo.topology)

    def check() -> None:
        recorded = read_config(run.path)
        check_same(recorded, config, run.path)
        run.changes = changes_around(recorded, config)
        if run.changes:
            began = ", ".join(run.changes)
            words = "%s: began with %s: colours may differ in bits from those of an unbroken run"
            _log.warning(words, run.path, began)
        if not run.snapshots.is_symlink():
            remove_all_leftovers(run.snapshots)

    with run.opened(resume, start, check):
        yield run


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
