# SPDX-License-Identifier: GPL-3.0-or-later
"""The `cloak` command lines that the add-on gives the trainer.

Nothing here imports `cloak_core`; the two sides share files and exit codes only.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from ..files.specs import split_spec

SAMPLES = {"BARE": "sample:train", "CLOTHED": "sample-clothed:train"}
"""The people that Add Sample Body brings; those kept back from them are for evaluation."""


@dataclass(frozen=True)
class TrainRequest:
    """Options of `cloak train` by their names; empty strings and None leave the trainer's own default."""

    detectors: tuple[str, ...] = ("builtin",)
    backgrounds: str = ""
    angles: str = "-10:10:5"
    preset: str = ""
    steps: int | None = None
    device: str = ""
    config: str = ""
    """TOML file with further settings of the trainer."""

    def options(self, *names: str) -> list[str]:
        """Those of the named options (all, where none is named) that are set, as words of a command line."""
        given = {name: value for name, value in asdict(self).items() if value not in ("", None)}
        # In one word: a value that starts with a minus looks like an option otherwise.
        words = detector_options(given.pop("detectors")) if not names or "detectors" in names else []
        return words + [f"--{name}={given[name]}" for name in given if not names or name in names]


def detector_options(specs: Iterable[str]) -> list[str]:
    """Each detector as an option of its own."""
    return [f"--detector={spec}" for spec in specs]


def differing_options(begun: list[str], now: list[str]) -> str:
    """What a run was started with where the options are others now: "steps 60 (not 120), ..."; "" where nothing is."""
    was, wanted = ({}, {})
    for words, given in ((begun, was), (now, wanted)):
        for name, _, value in (word.partition("=") for word in words):
            given[name] = f"{given[name]}, {value}" if name in given else value
    names = [
        name for name in was | wanted if was.get(name) != wanted.get(name) and name not in ("--init", "--made-from")
    ]
    return ", ".join(
        f"{name.strip('-')} {was.get(name, 'as by default')} (not {wanted.get(name, 'the default')})" for name in names
    )


def absolute_detector(spec: str) -> str:
    """A detector's name with the files in it as absolute paths: the trainer works in a folder of its own."""
    return ":".join(_absolute_file(part) for part in split_spec(spec))


def _absolute_file(part: str) -> str:
    for path in (part, part.rpartition("@")[0]):  # what follows the @ are options
        if path and Path(path).is_file():
            return str(Path(path).absolute()) + part[len(path) :]
    return part


def train_command(python: str, options: list[str], scene: Path, logo: Path, run: Path) -> list[str]:
    """`cloak train` on an export; `--resume` may be appended."""
    return _cloak(python, "train", "--scene", scene, "--logo", logo, *options, "--out", run)


def heatmap_command(python: str, request: TrainRequest, scene: Path, out: Path, events: Path) -> list[str]:
    """`cloak logo heatmap`."""
    options = request.options("backgrounds", "angles", "device")
    first = detector_options(request.detectors[:1])  # a heat map is of one detector
    return _cloak(python, "logo", "heatmap", "--scene", scene, *first, *options, "--out", out, "--events", events)


def sample_command(python: str, out: Path, people: str = "BARE") -> list[str]:
    """`cloak scene sample`; `people` are a key of `SAMPLES`."""
    clothed = ["--clothed"] if people == "CLOTHED" else []
    return _cloak(python, "scene", "sample", "--out", out, "--split", SAMPLES[people].partition(":")[2], *clothed)


def check_command(python: str, spec: str, image: Path) -> list[str]:
    """`cloak detectors check` on one image."""
    return _cloak(python, "detectors", "check", spec, "--image", image)


def verify_command(python: str, spec: str) -> list[str]:
    """`cloak detectors verify`, on one render: enough to know whether, and from which score on, it works."""
    return _cloak(python, "detectors", "verify", spec, "--renders", 1)


def evaluate_command(python: str, run: Path, options: list[str], events: Path) -> list[str]:
    """`cloak evaluate`."""
    return _cloak(python, "evaluate", run, *options, "--events", events)


def film_command(python: str, run: Path, scene: Path, options: list[str], out: Path, events: Path) -> list[str]:
    """`cloak film`."""
    return _cloak(python, "film", run, "--scene", scene, *options, "--out", out, "--events", events)


def wear_command(python: str, run: Path, people: Path, specs: Iterable[str], device: str, out: Path) -> list[str]:
    """`cloak wear`."""
    options = [*detector_options(specs), f"--device={device}"]
    return _cloak(python, "wear", run, f"--people={people}", *options, "--out", out)


def print_command(python: str, run: Path, scene: Path, out: Path) -> list[str]:
    """`cloak print`."""
    return _cloak(python, "print", run, "--scene", scene, "--out", out)


def look_command(python: str, specs: Iterable[str], device: str) -> list[str]:
    """`cloak look`, which answers what it is asked on standard input."""
    return _cloak(python, "look", "-", *detector_options(specs), f"--device={device}")


def report_command(python: str, run: Path) -> list[str]:
    """`cloak report`."""
    return _cloak(python, "report", run)


def _cloak(python: str, *words: object) -> list[str]:
    return [python, "-m", "cloak_core", *map(str, words), "--json"]
