"""Table 1: letter G, smiley and chest + thighs against every detector, trained at one angle and at five."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from matplotlib.figure import Figure
from PIL import Image

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.contact_sheet import draw_sheet, judged
from cloak_core.evaluation.controls import CLOTHING, LOGO
from cloak_core.evaluation.experiments.drawing import rate_bars, rates_along_x, threshold_axis, threshold_curve
from cloak_core.evaluation.experiments.lab import MULTI, SINGLE, Lab, Trained
from cloak_core.evaluation.experiments.logos import paper_logos
from cloak_core.evaluation.experiments.numbers import Numbers, Rows, best_row, group, select
from cloak_core.evaluation.experiments.repeats import Repeats
from cloak_core.evaluation.figures import CYCLE, SERIES, WIDTH, legend_above, new_figure, panel_title, percent_axis
from cloak_core.evaluation.pictures import failure_trials, gallery_trials, shoot_pair
from cloak_core.evaluation.rates import THRESHOLDS
from cloak_core.evaluation.report.words import degrees, file_name, percent, said, short_name
from cloak_core.scene.logos.logo import area_share

TITLE = "Attack success by logo and training angles (table 1)"
PAPER = [
    {"detector": "YOLOv2", "logo": "none", "single": 0.01, "multi": 0.01},
    {"detector": "YOLOv2", "logo": "letter G", "single": 0.98, "multi": 0.86},
    {"detector": "YOLOv2", "logo": "smiley", "single": 0.98, "multi": 0.88},
    {"detector": "YOLOv2", "logo": "chest + thighs", "single": 0.99, "multi": 0.93},
    {"detector": "Faster R-CNN", "logo": "none", "single": 0.01, "multi": 0.01},
    {"detector": "Faster R-CNN", "logo": "letter G", "single": 0.68, "multi": 0.62},
    {"detector": "Faster R-CNN", "logo": "smiley", "single": 0.51, "multi": 0.47},
    {"detector": "Faster R-CNN", "logo": "chest + thighs", "single": 0.99, "multi": 0.91},
]
WHOLE = {"logo": "chest + thighs", "training": "multi"}
"""The row that the words are about."""
SIDE = 160
"""Of a contact sheet's picture, pixels."""


def measure(lab: Lab) -> Numbers:
    bodies = lab.materials.bodies
    logos = paper_logos(bodies, lab.options.out / "table1")
    rows, pictures = [], {}
    for spec in lab.specs:
        for name, faces in logos.items():
            for training, angles in (("single", SINGLE), ("multi", MULTI)):
                trained = lab.repeat(faces, [spec], angles=angles)
                result = lab.evaluate(trained, lab.angles, [spec])
                label = {"logo": name, "training": training, "area_share": round(area_share(bodies, faces), 4)}
                rows.append(label | result.row(spec))
        # The last is chest + thighs, trained at five angles; own clothing is the same beside every logo.
        rows.append({"logo": "none", "training": "-", "detector": spec} | result.rate_row(spec, CLOTHING))
        pictures |= _contact_sheets(lab, spec, trained[0], result)
    facts = {"angles": len(lab.angles), "steps": {spec: lab.steps([spec]) for spec in lab.specs}}
    return Numbers(rows, facts, pictures)


def tell(numbers: Numbers) -> list[str]:
    words = [
        "Each logo was trained at azimuth 0 (single) and at -10, -5, 0, 5, 10 degrees (multi) and tested on unseen "
        f"bodies and backgrounds at {numbers.facts['angles']} azimuths in -10..10. Letter and smiley are scaled to the "
        "share of the body's area that the paper's have of its faces (4.4 %); chest + thighs is given at the paper's "
        "share (8.5 %, small) and whole."
    ]
    for spec, rows in group(numbers.rows, "detector").items():
        (none,), (whole,) = select(rows, logo="none"), select(rows, **WHOLE)
        best = best_row([row for row in rows if row is not none])
        words.append(
            f"{short_name(spec)}, {numbers.facts['steps'][spec]} steps: chest + thighs, multi-angle {said(whole)}; own "
            f"clothing {said(none)}; grey {percent(whole['grey'])}, random {percent(whole['random'])}, stripes "
            f"{percent(whole['stripes'])}, checks {percent(whole['checks'])} on the same images. The highest of "
            f"the table is {best['logo']}, {best['training']}-angle, at {percent(best['success'])} (the largest of "
            "several: read it as such)."
        )
    return words


def draw(numbers: Numbers) -> dict[str, Figure]:
    return {"success": _success_figure(numbers.rows), "thresholds": _threshold_figure(numbers.thresholds)}


def _success_figure(rows: Rows) -> Figure:
    names = [name for name in group(rows, "logo") if name != "none"]
    panels = group(rows, "detector")
    figure, axes = new_figure(WIDTH, 0.9 + 0.42 * len(names), len(panels), sharey=True)
    looks = {"single": ("one angle", CYCLE[1], "s", -0.13), "multi": ("five angles", CYCLE[0], "o", 0.13)}
    for axis, (spec, mine) in zip(axes, panels.items(), strict=True):
        rates_along_x(axis, names)
        for training, (label, color, marker, offset) in looks.items():
            shown = select(mine, training=training)
            at = [names.index(row["logo"]) + offset for row in shown]
            rate_bars(axis, shown, at, color, marker, f"trained at {label}")
        panel_title(axis, short_name(spec), len(panels))
    legend_above(figure)
    return figure


def _threshold_figure(thresholds: Rows) -> Figure:
    panels = group(select(thresholds, **WHOLE), "detector")
    figure, axes = new_figure(WIDTH, 2.7, len(panels), sharey=True)
    for axis, (spec, rows) in zip(axes, panels.items(), strict=True):
        for row in rows:
            look = SERIES[row["control"]]
            axis.plot(THRESHOLDS, threshold_curve(row), color=look.color, ls=look.dash, label=look.label)
        panel_title(axis, short_name(spec), len(panels))
        threshold_axis(axis)
    percent_axis(axes[0])
    legend_above(figure)
    return figure


def _contact_sheets(lab: Lab, spec: str, trained: Trained, result: Repeats) -> dict[str, Image.Image]:
    """Up to two sheets: unseen bodies in own clothing and cloaked, and the cloaked images that score highest, where
    any is above the threshold. Which are shown is decided by rule (see `pictures.py`), before anyone has seen a score.

    `result` is the evaluation of `trained` (of several seeds the first).
    """
    stage = lab.stage(trained, lab.angles, lab.evaluate_settings())
    detectors = {spec: lab.materials.detectors[spec]}
    failures = failure_trials(result.measurements[0], result.specs.index(spec), THRESHOLD)
    sheets = {}
    with TemporaryDirectory() as folder:
        for name, trials in {"gallery": gallery_trials(stage.trials), "failures": failures}.items():
            shots = [shoot_pair(Path(folder), stage, trial, detectors, THRESHOLD) for trial in trials]
            if not shots:
                continue
            bodies = {"": shots} if name == "failures" else group(shots, "body")
            heads = [degrees(shot["angle"]) for shot in next(iter(bodies.values()))]
            if name == "failures":
                heads = [f"{shot['body'][:12]}, {degrees(shot['angle'])}" for shot in shots]
            rows = [
                (SERIES[control].label, [judged(Path(folder), shot[control], spec, SIDE) for shot in mine])
                for mine in bodies.values()
                for control in (CLOTHING, LOGO)
            ]
            sheets[f"{name}-{file_name(spec)}"] = draw_sheet(heads, rows, SIDE)
    return sheets
