"""`cloak evaluate` and `cloak report`: what a run is worth, in numbers and in pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from rich.progress import Progress
from rich.table import Table
from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from cloak_core.attack.settings.run import ComputeSettings
from cloak_core.attack.settings.values import Angles
from cloak_core.commands.base import Command, err, open_scene, out
from cloak_core.commands.compute import prepare_process
from cloak_core.commands.detector_options import DetectorOptions
from cloak_core.evaluate.settings import EvaluateSettings
from cloak_core.exchange.colors import read_colors
from cloak_core.exchange.face_lists import face_ids, read_face_list
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.scene.selection import split_selection

COUNTERPART = {":train": {"scene": ":unseen", "backgrounds": ":test"}}
"""What was kept back from training on embedded material."""


@dataclass(kw_only=True)
class Evaluate(Command):
    """Measure a trained cloak on unseen bodies, backgrounds and angles, beside controls on the same images."""

    run_folder: Positional[Path]
    """Run folder that `cloak train` wrote."""
    scene: str | None = None
    """Bodies to judge on: scene folder, .npz, or sample:unseen (the default after training on sample:train)."""
    backgrounds: str | None = None
    """Folder of images, or procedural:test (the default after training on procedural:train)."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """Detectors to judge with (default: those it was trained against)."""
    angles: Angles = Angles.parse("-10:10:1")
    """Azimuths in degrees: A:B:STEP or a comma list."""
    options: Annotated[OmitArgPrefixes[DetectorOptions], arg(name="detectors")] = field(default_factory=DetectorOptions)
    settings: Annotated[OmitArgPrefixes[EvaluateSettings], arg(name="evaluation")] = field(
        default_factory=EvaluateSettings
    )
    compute: Annotated[OmitArgPrefixes[ComputeSettings], arg(name="computing")] = field(default_factory=ComputeSettings)

    def run(self) -> dict:
        from cloak_core.evaluate.evaluation import evaluate
        from cloak_core.evaluate.evaluation_folder import FOLDER
        from cloak_core.evaluate.provenance import training_record
        from cloak_core.scene.backdrops.backgrounds import open_backgrounds
        from cloak_core.scene.logos.logo import make_logo

        prepare_process(self.compute)
        config = read_run(self.run_folder)
        bodies = open_scene(self.scene or kept_back("scene", config))
        backgrounds = open_backgrounds(self.backgrounds or kept_back("backgrounds", config))
        logo = make_logo(bodies, face_ids(read_face_list(self.run_folder / "logo.npy", bodies), bodies))
        colors = read_colors(self.run_folder / "colors.npy", len(logo.face_ids))
        specs = self.detector or tuple(trained["spec"] for trained in config["detectors"])
        detectors = dict(zip(specs, self.options.load(specs, self.compute.device), strict=True))
        with Progress(console=err, disable=not err.is_terminal) as progress:
            task = progress.add_task("evaluating", total=None)
            return evaluate(
                colors,
                logo,
                bodies,
                backgrounds,
                detectors,
                self.angles,
                self.settings,
                training=training_record(self.run_folder),
                out=self.run_folder / FOLDER,
                on_progress=lambda done, total: progress.update(task, completed=done, total=total),
            )

    def show(self, result: dict) -> None:
        show_success(result)


def read_run(folder: Path) -> dict:
    """A run's config.json; InputError when this is no finished run."""
    if not (folder / "config.json").exists():
        raise InputError(f"{folder}: not a run folder (no config.json in it)")
    if not (folder / "colors.npy").exists():
        raise InputError(f"{folder}: has no trained colours yet (no colors.npy in it)")
    config = read_json(folder / "config.json")
    inputs, detectors = config.get("inputs", {}), config.get("detectors")
    if not isinstance(inputs, dict) or not all(isinstance(value, str) for value in inputs.values()):
        raise InputError(f"{folder / 'config.json'}: inputs is not a record of names")
    if not isinstance(detectors, list) or not all(
        isinstance(d, dict) and isinstance(d.get("spec"), str) for d in detectors
    ):
        raise InputError(f"{folder / 'config.json'}: detectors is not a list of records, each with its spec")
    return config


def kept_back(kind: str, config: dict) -> str:
    """The embedded material that training did not see; for anything else the user must say."""
    inputs = config.get("inputs", {})
    made_from = inputs.get("made_from", "") if kind == "scene" else ""
    spec, _ = split_selection(made_from or inputs.get(kind, ""))
    head, mark, rest = spec.partition(":train")
    if mark and head in ("sample", "procedural"):
        return head + COUNTERPART[":train"][kind] + rest
    raise InputError(f"--{kind}: say what to evaluate on (training saw {spec or 'something unrecorded'})")


BOXES = {True: "white", False: "black", None: "?"}


def show_success(result: dict) -> None:
    """Success under the logo and under each control, a table per detector; of several, all of them side by side first.

    White box: the colours were trained against this detector; black box: they were not.
    """
    if len(result["detectors"]) > 1:
        out.print(matrix(result))
    for spec, measured in result["detectors"].items():
        table = Table(title=f"success against {spec}: the rendered person is not reported")
        for column in ("", "success", "95 %", "IoU ≥ 0.5", "of those found clean", "images"):
            table.add_column(column, justify="left" if not column else "right")
        for name, rates in measured.items():
            if not isinstance(rates, dict) or "success" not in rates:
                continue
            low, high = rates["ci95"]
            conditional = rates["conditional"]
            table.add_row(
                name,
                f"{rates['success']:.2f}",
                f"{low:.2f}–{high:.2f}",
                f"{rates['success_iou']:.2f}",
                "–" if conditional is None else f"{conditional:.2f}",
                str(rates["n"]),
            )
        out.print(table)
        out.print(f"false alarms on bare backgrounds: {result['false_alarms'][spec]:.1%}")


def matrix(result: dict) -> Table:
    """A row per detector: whether it was trained against, and success under the logo and the controls."""
    from cloak_core.evaluate.report.words import short_name

    controls = [name for name, rates in next(iter(result["detectors"].values())).items() if "success" in rates]
    table = Table(title="success by detector: white box = trained against it, black box = not")
    for column in ("", "box", *controls, "95 % of logo", "alarms"):
        justify = "left" if column in ("", "box") else "right"
        table.add_column(column, justify=justify, no_wrap=bool(column), min_width=None if column else 12)
    boxes = result.get("white_box", {})
    for spec, measured in sorted(result["detectors"].items(), key=lambda item: boxes.get(item[0]) is not True):
        low, high = measured["logo"]["ci95"]
        successes = (f"{measured[name]['success']:.2f}" for name in controls)
        box, alarms = BOXES[boxes.get(spec)], f"{result['false_alarms'][spec]:.1%}"
        table.add_row(short_name(spec), box, *successes, f"{low:.2f}–{high:.2f}", alarms)
    return table


@dataclass(kw_only=True)
class Report(Command):
    """Write a run's report: one HTML file that opens offline."""

    run_folder: Positional[Path]
    """Run folder that `cloak train` wrote."""

    def run(self) -> dict:
        from cloak_core.evaluate.report import make_report

        read_run(self.run_folder)
        return {"report": str(make_report(self.run_folder))}

    def show(self, result: dict) -> None:
        out.print(f"wrote {result['report']}")
