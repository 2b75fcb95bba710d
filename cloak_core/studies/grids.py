"""Grids of a sweep: what all runs share, and lists of values for what varies."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from cloak_core.core.settings import TrainSettings, merge, settings_from_record
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_toml
from cloak_core.files.specs import require_named

MOST_RUNS = 200_000
INPUTS = ("scene", "logo", "detector", "backgrounds")
"""What a grid may name beside settings."""


@dataclasses.dataclass(frozen=True)
class SweepRun:
    """One combination."""

    varied: dict[str, object]
    """What the grid gives it."""
    scene: str
    logo: str
    backgrounds: str
    detectors: tuple[str, ...]
    settings: TrainSettings

    @property
    def label(self) -> str:
        """For people."""
        return ", ".join(f"{key}={words(value)}" for key, value in self.varied.items())

    @property
    def file_label(self) -> str:
        """The label as the beginning of a folder's name."""
        return re.sub(r"[^\w.,=+-]+", "_", self.label.replace(", ", ","))[:80]


def read_grid(
    path: str | Path, changes: Mapping[str, object] | None = None, named: Sequence[str] = ()
) -> list[SweepRun]:
    """Read the runs of a grid file: every combination of the lists in [grid], over [base], in the file's order.

    [base] and [grid] take the settings of `cloak train` by name, and scene, logo, detector, backgrounds, as on the
    command line. In [grid] each name has a list of values; an entry of `detector` may itself be a list, of detectors
    to be trained against at once. `changes` replace what [base] says; of its detectors only those `named` here may run
    code or ask the network. InputError names the file and the key.
    """
    path = Path(path)
    record = read_toml(path)
    for name in record:
        if name not in ("base", "grid") or not isinstance(record[name], dict):
            raise InputError(f"{path}: '{name}' is neither the table [base] nor [grid]")
    base = _keys(record.get("base", {}), path) | dict(changes or {})
    grid = _keys(record.get("grid", {}), path)
    if not grid:
        raise InputError(f"{path}: no [grid] to sweep over")
    for key, values in grid.items():
        if key in base:
            raise InputError(f"{path}: '{key}' stands in [base] and in [grid]")
        if not isinstance(values, list) or not values:
            raise InputError(f"{path}: [grid] {key}: a list of values is needed, such as [1, 2]")
        counts = Counter(map(_hashable, values))
        twice = [value for value in values if counts[_hashable(value)] > 1]
        if twice:
            raise InputError(f"{path}: [grid] {key}: {twice[0]!r} stands there twice")
    count = math.prod(map(len, grid.values()))
    if count > MOST_RUNS:
        raise InputError(f"{path}: {count} runs, more than {MOST_RUNS}")
    combinations = (dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values()))
    runs = [_run(base, varied, path) for varied in combinations]
    require_named((spec for run in runs for spec in run.detectors), path, named)
    return runs


def _keys(table: dict, path: Path) -> dict:
    changed = {key.replace("-", "_"): value for key, value in table.items()}
    if len(changed) < len(table):
        raise InputError(f"{path}: a name stands there twice, once with - and once with _")
    return changed


def _run(base: dict, varied: dict, path: Path) -> SweepRun:
    named = {"backgrounds": "procedural:train", "detector": "builtin"} | base | varied
    for key in INPUTS:
        if key not in named:
            raise InputError(f"{path}: {key} is missing (in [base] or [grid])")
    inputs = {key: named[key] for key in INPUTS}
    specs = inputs.pop("detector")
    specs = specs if isinstance(specs, list) else [specs]
    if not specs:
        raise InputError(f"{path}: detector: none given")
    for key, value in [*inputs.items(), *(("detector", spec) for spec in specs)]:
        if not isinstance(value, str) or not value:
            raise InputError(f"{path}: {key}: {value!r} is not text")
    try:
        layers = ({key: value for key, value in table.items() if key not in INPUTS} for table in (base, varied))
        settings = settings_from_record(merge(*layers))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return SweepRun(varied=varied, detectors=tuple(specs), settings=settings, **inputs)


def _hashable(value: object) -> object:
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def words(value: object) -> str:
    """Write a value of a grid for people."""
    return "+".join(map(words, value)) if isinstance(value, list) else str(value)
