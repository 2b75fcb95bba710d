"""Every experiment by name, and the page that gathers them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cloak_core.evaluate.experiments import attacks, choices, render_gap, variation, views
from cloak_core.evaluate.experiments.lab import Lab
from cloak_core.evaluate.experiments.outcome import Outcome, write_outcome
from cloak_core.evaluate.figures import style
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json

EXPERIMENTS: dict[str, Callable[[Lab], Outcome]] = {
    "table1": attacks.table1,
    "single-angle": views.single_angle,
    "wide-angle": views.wide_angle,
    "transfer": attacks.transfer,
    "tv": variation.tv,
    "distance": views.distance,
    "shape": attacks.shape,
    "resolution": choices.resolution,
    "ablation": choices.ablation,
    "render-gap": render_gap.render_gap,
    "cost": choices.cost,
}
"""In the order in which `all` runs them."""


def run_experiment(name: str, lab: Lab) -> dict:
    """Run one experiment and write OUT/NAME; returns its record (rows, words, figures, the paper's values).

    Raises `InputError` for an unknown name, `lab.Interrupted` when a training was stopped in order: the same call goes
    on from there.
    """
    if name not in EXPERIMENTS:
        raise InputError(f"experiment '{name}': not one of {', '.join(EXPERIMENTS)}, all")
    with style():
        return write_outcome(name, EXPERIMENTS[name](lab), lab)


def finished(out: Path) -> dict[str, dict]:
    """Records of the experiments that OUT holds, in the registry's order."""
    paths = {name: out / name / "numbers.json" for name in EXPERIMENTS}
    return {name: read_json(path) for name, path in paths.items() if path.exists()}
