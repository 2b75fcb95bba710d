"""Every experiment by name: measured, then drawn and told from its numbers."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

from cloak_core.evaluation.experiments.drawing import threshold_figure
from cloak_core.evaluation.experiments.lab import Lab
from cloak_core.evaluation.experiments.numbers import read_numbers, write_numbers
from cloak_core.evaluation.figures import save_figure, style
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_json, write_text

EXPERIMENTS = (
    "table1",
    "single-angle",
    "wide-angle",
    "transfer",
    "tv",
    "distance",
    "shape",
    "resolution",
    "ablation",
    "render-gap",
    "cost",
    "white-box",
    "defences",
    "hardened",
)
"""In the order in which `all` runs them; each is the module of its name."""
BY_DETECTOR = ("table1", "single-angle", "white-box")
"""Whose trainings for one detector have nothing to do with those for the others."""


def run_experiment(name: str, lab: Lab) -> dict:
    """Run one experiment and write OUT/NAME; returns its record (rows, words, figures, the paper's values).

    Raises `InputError` for an unknown name, `lab.Interrupted` when a training was stopped in order: the same call goes
    on from there.
    """
    numbers = _experiment(name).measure(lab)
    write_numbers(lab.options.out / name, name, numbers, lab)
    return draw_again(name, lab.options.out)


def prepare_experiment(name: str, lab: Lab) -> None:
    """Make the trainings and evaluations of an experiment, and write nothing of it: `run_experiment` then finds them.

    Raises as `run_experiment` does.
    """
    _experiment(name).measure(lab)


def draw_again(name: str, out: Path) -> dict:
    """Draw and tell one experiment from OUT/NAME/numbers.json alone; returns its record.

    InputError: it was never run, or by an earlier version.
    """
    experiment, folder = _experiment(name), out / name
    record, numbers = read_numbers(folder)
    with style():
        figures = experiment.draw(numbers)
        if "thresholds" not in figures and (plot := threshold_figure(numbers.thresholds)):
            figures["thresholds"] = plot
        files = [path.name for key, figure in figures.items() for path in save_figure(figure, folder / key)]
    words = experiment.tell(numbers)
    write_text(folder / "words.md", f"# {experiment.TITLE}\n\n" + "\n\n".join(words) + "\n")
    record |= {"title": experiment.TITLE, "paper": getattr(experiment, "PAPER", []), "words": words}
    record["figures"] = [*files, *record["pictures"]]
    write_json(folder / "numbers.json", record)
    return record


def _experiment(name: str) -> ModuleType:
    if name not in EXPERIMENTS:
        raise InputError(f"experiment '{name}': not one of {', '.join(EXPERIMENTS)}, all")
    return import_module(f"cloak_core.evaluation.experiments.{name.replace('-', '_')}")


def finished(out: Path) -> dict[str, dict]:
    """Records of the experiments that OUT holds, in the registry's order."""
    paths = {name: out / name / "numbers.json" for name in EXPERIMENTS}
    records = {name: read_json(path) for name, path in paths.items() if path.exists()}
    return {name: record for name, record in records.items() if "words" in record}
