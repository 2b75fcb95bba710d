"""Options that several commands share: where to compute, which detectors, which bodies and backgrounds.

A command that computes prepares its process by them, before it begins; nothing below the commands does. Who uses Cloak
as a library decides on threads and memory alone.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from cloak_core.commands.base import Command, err, warn
from cloak_core.core.settings import check_settings
from cloak_core.core.settings.components import ComputeSettings
from cloak_core.files.errors import first_line

if TYPE_CHECKING:
    from cloak_core.core.detector.protocol import Detector
    from cloak_core.core.source import Cast
    from cloak_core.sources.photographs.people import People
    from cloak_core.studies.store import DataSplit

_MMAP_MAX, _TRIM_THRESHOLD, _ARENA_MAX = -4, -1, -8
"""Options of mallopt(3)."""


def prepare_process(settings: ComputeSettings) -> None:
    """Set torch's threads, and keep freed memory. InputError: no such number, or no such device."""
    check_settings(settings)
    keep_freed_memory()
    if settings.device != "cpu":
        from cloak_core.core.surroundings import usable_device

        usable_device(settings.device)
    if settings.threads is not None:
        import torch

        torch.set_num_threads(settings.threads)


def chosen_device(device: str) -> str:
    """Choose what "auto" stands for: CUDA where it works, and say so, else the CPU. Other names stay."""
    if device != "auto":
        return device
    import torch

    if not torch.cuda.is_available():
        return "cpu"
    try:
        torch.zeros(1, device="cuda").add_(1).item()
    except RuntimeError as error:
        warn(f"CUDA is there and does not work ({first_line(error)}): computing on the CPU")
        return "cpu"
    err.print(f"computing on {torch.cuda.get_device_name()} (--device cpu for the CPU)")
    return "cuda"


def keep_freed_memory() -> bool:
    """Have this process reuse what it frees; tell whether that could be arranged (glibc on Linux).

    glibc maps large blocks anew and unmaps them when they are freed. A step frees hundreds of megabytes of activations
    and images and takes them again, and the system hands them out page by page, zeroed: up to 30,000 page faults a
    step, a tenth of the time of a small detector. The price: the process stays as large as it ever was.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:  # another C library (musl)
        return False
    return all([mallopt(_MMAP_MAX, 0), mallopt(_TRIM_THRESHOLD, -1), mallopt(_ARENA_MAX, 1)])


@dataclass(kw_only=True)
class DetectorOptions:
    """How detectors are loaded and run."""

    precision: Literal["float32", "bfloat16", "auto"] = "float32"
    """bfloat16: autocast (faster on GPUs, rough gradients); auto: where the device gains."""
    compile: bool = False
    """Use torch.compile (needs a C++ compiler, and time for each image size)."""
    download: bool = False
    """Fetch missing official weights of torchvision and transformers models."""

    def arguments(self) -> dict:
        """Give the options as `load_detector` takes them."""
        options = vars(self) | {"compiled": self.compile}
        return {name: value for name, value in options.items() if name != "compile"}


@dataclass(kw_only=True)
class Computing(Command):
    """A command that computes."""

    compute: Annotated[OmitArgPrefixes[ComputeSettings], arg(name="computing")] = field(
        default_factory=lambda: ComputeSettings(device="auto")
    )

    def prepare(self) -> None:
        """Ready the process for computing, and choose the device. InputError: no such one, or number of threads."""
        self.compute = replace(self.compute, device=chosen_device(self.compute.device))
        prepare_process(self.compute)


@dataclass(kw_only=True)
class Detecting(Computing):
    """A command that runs detectors."""

    options: Annotated[OmitArgPrefixes[DetectorOptions], arg(name="detectors")] = field(default_factory=DetectorOptions)

    def load(self, spec: str) -> Detector:
        """Load one detector."""
        from cloak_core.detectors.loading import load_detector

        return load_detector(spec, device=self.compute.device, **self.options.arguments())

    def by_spec(self, specs: Iterable[str]) -> dict[str, Detector]:
        """Load each of the detectors once, by its full spec."""
        from cloak_core.detectors.naming import full_spec

        return {spec: self.load(spec) for spec in dict.fromkeys(map(full_spec, specs))}


@dataclass(kw_only=True)
class Watched(Detecting):
    """A command that tells a program how far it is."""

    events: Path | None = None
    """New file of progress for programs: JSON lines, as in a run's events.jsonl."""


@dataclass(kw_only=True)
class AboutRun(Command):
    """A command about a run, or an entry of the zoo."""

    run_folder: Positional[Path]
    """Run folder of `cloak train`, or zoo:NAME."""

    def opened(self) -> tuple[Path, dict]:
        """Find the run's folder and read its config.json. InputError: no finished run."""
        from cloak_core.studies.trained_run import read_run
        from cloak_core.zoo.entry import run_path

        folder = run_path(self.run_folder)
        return folder, read_run(folder)


@dataclass(kw_only=True)
class OnUnseen(AboutRun):
    """A command that shows a run on bodies and backgrounds that its training never saw."""

    scene: str | None = None
    """(default: those kept back from training)"""
    backgrounds: str | None = None
    """(default: those kept back from training)"""


@dataclass(kw_only=True)
class Photographed(Command):
    """A command that takes people in photographs."""

    people: str | None = None
    images: Path | None = None

    def load_people(self) -> People | None:
        """Read the people; None: none are named. InputError: they cannot be read."""
        if not self.people:
            return None
        from cloak_core.sources.photographs.people import load_people

        return load_people(self.people, self.images)

    def cast(self) -> Cast:
        """Make what shows the people, nobody where none are named. InputError: they cannot be read."""
        from cloak_core.library.values import cast_of

        return cast_of(self.people, self.images)


@dataclass(kw_only=True)
class Splitting(Photographed):
    """A command that trains on a part of its bodies, backgrounds and people, and judges on the rest."""

    scene: str = "sample"
    unseen: str | None = None
    """Bodies to judge on (default: every second of --scene, or samples kept back)."""
    people: str | None = None
    backgrounds: str = "procedural"
    unseen_backgrounds: str | None = None
    """Backgrounds to judge on (default: every second of --backgrounds)."""

    def split(self, detectors: dict[str, Detector], with_people: bool = True) -> DataSplit:
        """Open the material and split it. InputError: something cannot be opened, or is too little to split."""
        from cloak_core.core.source import NOBODY
        from cloak_core.studies.store import open_data_split

        return open_data_split(
            detectors,
            scene=self.scene,
            unseen=self.unseen,
            backgrounds=self.backgrounds,
            unseen_backgrounds=self.unseen_backgrounds,
            people=self.cast() if with_people else NOBODY,
        )
