"""`cloak evaluate` and `cloak report`: measure a run, in numbers and in pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from rich.table import Table
from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from cloak_core.commands.base import Command, format_rate, out, table
from cloak_core.commands.options import OnUnseen, Photographed, Watched
from cloak_core.commands.progress import counted
from cloak_core.commands.wear import show_people
from cloak_core.core.detector import THRESHOLD
from cloak_core.core.evaluation.settings import EvaluateSettings
from cloak_core.core.settings.values import Angles


@dataclass(kw_only=True)
class Evaluate(OnUnseen, Photographed, Watched):
    """Measure a trained cloak on unseen bodies and backgrounds, beside controls.

    With --people: on people in photographs instead, into RUN/evaluation-people.
    """

    example = "runs/first"
    next_why = "one page with pictures"

    colors: str | None = None
    """Other colours, into RUN/evaluation-NAME: FILE.npy, a picture on the UV map, FILE.png@tile=METRES,
    print:NAME@tile=METRES, pattern:NAME, a run, zoo:NAME; with --people FILE.png@patch=METRES."""
    logo: str | None = None
    profile: Path | None = None
    """Profile (`cloak calibrate`): judge colours as printed by it, into RUN/evaluation-printed."""
    out: Path | None = None
    """Folder for the evaluation; another one there is replaced (default: RUN/evaluation)."""
    people: str | None = None
    over_time: bool = False
    """Also judge the snapshots of training (--snapshot-every): RUN/curve.json, curve.png."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """(default: those it was trained against)"""
    angles: Angles = Angles.parse("-10:10:1")
    settings: Annotated[OmitArgPrefixes[EvaluateSettings], arg(name="evaluation")] = field(
        default_factory=EvaluateSettings
    )

    def run(self) -> dict:
        from cloak_core.library.evaluation import evaluate
        from cloak_core.studies.trained_run import trained_specs

        self.prepare()
        folder, config = self.opened()
        detectors = self.by_spec(self.detector or trained_specs(folder, config))
        names = ("colors", "logo", "profile", "out", "over_time", "angles", "settings")
        how = {name: getattr(self, name) for name in names} | {"people": self.load_people()}
        with counted("evaluating", self.events) as tell:
            return evaluate(self.run_folder, self.scene, self.backgrounds, detectors, on_progress=tell, **how)

    def show(self, result: dict) -> None:
        show_success(result)
        if "people" in result:
            show_people(result)
        for row in result.get("over_time", []):
            rates = ", ".join(f"{figures['success']:.2f}" for figures in row["detectors"].values())
            seconds = "" if row["seconds"] is None else f", {row['seconds']:.0f} s"
            out.print(f"step {row['step']}{seconds}: success {rates}")

    def following(self, result: dict) -> tuple[str, ...]:
        return () if str(self.run_folder).startswith("zoo:") else ("report", str(self.run_folder))


BOXES = {True: "white", False: "black", None: "?"}
MOST_CONTROLS = 4
"""Of the table of several detectors: more leave no room for their names. Each detector's own table has all."""


def show_success(result: dict) -> None:
    """Print success under the logo and each control, a table per detector; before these, one of several detectors.

    White box: the colours were trained against this detector; black box: they were not.
    """
    from cloak_core.studies.report.words import instead, percent

    if len(result["detectors"]) > 1:
        out.print(matrix(result))
    threshold = result.get("settings", {}).get("threshold", THRESHOLD)
    for spec, measured in result["detectors"].items():
        out.print(success_table(spec, measured, threshold, result.get("operating_points", {}).get(spec, 0)))
        logo = measured["logo"]
        out.print(f"no person in {percent(logo['success'])} at {threshold:g}{instead(logo)}")
        out.print(f"false alarms on bare backgrounds: {result['false_alarms'][spec]:.1%}")


def success_table(spec: str, measured: dict, threshold: float, own: float) -> Table:
    """Make the table of one detector; `own`: the detector's own threshold."""
    rates = {name: figures for name, figures in measured.items() if isinstance(figures, dict) and "success" in figures}
    images = next(iter(rates.values()))["n"]
    heads = ("", f"at {threshold:g}", "95 %", f"own {own:g}", "renamed", "gone", "on body", "AP50")
    rows = []
    for name, figures in rates.items():
        low, high = figures["ci95"]
        rest = (format_rate(figures.get(key)) for key in ("success_own", "renamed", "gone", "success_iou", "ap50"))
        rows.append((name, format_rate(figures["success"]), f"{low:.2f}–{high:.2f}", *rest))
    return table(f"{spec}: share of {images} images in which no person is reported", heads, rows)


def matrix(result: dict) -> Table:
    """Make a table with a row per detector: trained against or not, success under the logo and the controls."""
    from cloak_core.studies.report.words import short_name

    controls = [name for name, rates in next(iter(result["detectors"].values())).items() if "success" in rates]
    controls = controls[:MOST_CONTROLS]
    boxes, rows = result.get("white_box", {}), []
    for spec, measured in sorted(result["detectors"].items(), key=lambda item: boxes.get(item[0]) is not True):
        low, high = measured["logo"]["ci95"]
        successes = (f"{measured[name]['success']:.2f}" for name in controls)
        box, alarms = BOXES[boxes.get(spec)], f"{result['false_alarms'][spec]:.1%}"
        rows.append((short_name(spec), box, *successes, f"{low:.2f}–{high:.2f}", alarms))
    title = "success by detector: white box = trained against it, black box = not"
    return table(title, ("", "box", *controls, "95 % of logo", "alarms"), rows, words=2)


@dataclass(kw_only=True)
class Report(Command):
    """Write a run's report: one HTML file that opens offline."""

    example = "runs/first"

    run_folder: Positional[Path]
    """Run folder of `cloak train`."""

    def run(self) -> dict:
        from cloak_core.products.run_report import make_report
        from cloak_core.studies.trained_run import read_run
        from cloak_core.zoo.entry import best_run

        folder = best_run(self.run_folder)
        read_run(folder)
        return {"report": str(make_report(folder))}

    def show(self, result: dict) -> None:
        out.print(f"wrote {result['report']}: open it in a browser")
