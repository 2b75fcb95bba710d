"""Where a training's numbers and previews go beside the run folder: TensorBoard, MLflow, Weights & Biases.

Each is an extra with its own client, which decides where it writes or sends: nothing is sent unless it is asked for.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Literal

from cloak_core.core.pictures import read_picture
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json

Log = Literal["tensorboard", "mlflow", "wandb"]


class Logger:
    """Takes a run's events and hands scalars and previews to a client. InputError: its package is not installed.

    Subclasses say how: `begin(step)` begins, or goes on behind a step; `scalars(values, step)` takes numbers by
    GROUP/NAME; `picture(path, step)` takes a preview; `end()` writes out what is left.
    """

    package: ClassVar[str]
    """The client; the last part of its name is that of its extra."""
    title: ClassVar[str]
    """What people call it."""

    def __init__(self, run: Path) -> None:
        self.run = run
        self.is_open = False
        try:
            self.client = importlib.import_module(self.package)
        except ImportError:
            extra = self.package.rpartition(".")[2]
            raise InputError(f"--log {extra}: needs {self.title}: pip install 'cloak-core[{extra}]'") from None

    def __enter__(self) -> Logger:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if self.is_open:
            self.end()

    def __call__(self, event: dict) -> None:
        kind, step = event.get("type"), event["step"]
        if kind in ("start", "resume"):
            # Only now does the run folder exist.
            self.begin(step)
            self.is_open = True
        elif self.is_open and kind == "step":
            figures = {name: value for name, value in event.items() if isinstance(value, float) and name != "time"}
            self.scalars({f"training/{name}": value for name, value in figures.items()}, step)
        elif self.is_open and kind == "preview":
            self.picture(self.run / event["path"], step)

    def settings(self) -> dict:
        """Read the run's settings."""
        return read_json(self.run / "config.json").get("settings", {})


class TensorBoard(Logger):
    """Files in RUN/tensorboard."""

    package = "torch.utils.tensorboard"
    title = "TensorBoard"

    def begin(self, step: int) -> None:
        # What an earlier part wrote of later steps is hidden.
        self._writer = self.client.SummaryWriter(str(self.run / "tensorboard"), purge_step=step + 1)

    def scalars(self, values: dict[str, float], step: int) -> None:
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def picture(self, path: Path, step: int) -> None:
        self._writer.add_image("preview", read_picture(path), step, dataformats="HWC")

    def end(self) -> None:
        self._writer.close()


class MLflow(Logger):
    """A run of MLflow's, in the experiment and at the address that its own environment variables name."""

    package = "mlflow"
    title = "MLflow"

    def begin(self, step: int) -> None:
        self.client.start_run(run_name=self.run.name)
        self.client.log_params({name: str(value)[:500] for name, value in self.settings().items()})

    def scalars(self, values: dict[str, float], step: int) -> None:
        self.client.log_metrics(values, step=step)

    def picture(self, path: Path, step: int) -> None:
        self.client.log_artifact(str(path), "previews")

    def end(self) -> None:
        self.client.end_run()


class WandB(Logger):
    """A run of Weights & Biases, in the project and mode that its own environment variables name (project: cloak)."""

    package = "wandb"
    title = "Weights & Biases"

    def begin(self, step: int) -> None:
        self._run = self.client.init(project="cloak", name=self.run.name, dir=str(self.run), config=self.settings())

    def scalars(self, values: dict[str, float], step: int) -> None:
        self._run.log(values, step=step)

    def picture(self, path: Path, step: int) -> None:
        self._run.log({"preview": self.client.Image(str(path))}, step=step)

    def end(self) -> None:
        self._run.finish()


LOGGERS: dict[str, type[Logger]] = {"tensorboard": TensorBoard, "mlflow": MLflow, "wandb": WandB}
