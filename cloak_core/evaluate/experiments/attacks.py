"""Which logo hides from which detector: table 1, transfer between detectors, shape and size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from cloak_core.detectors.scoring import THRESHOLD
from cloak_core.evaluate.experiments.lab import Lab
from cloak_core.evaluate.experiments.logos import chest_thighs, paper_logos, shapes
from cloak_core.evaluate.experiments.outcome import Outcome
from cloak_core.evaluate.experiments.repeats import Repeats
from cloak_core.evaluate.experiments.sheets import contact_sheets
from cloak_core.evaluate.experiments.wording import best_row, file_name, rate_text, said
from cloak_core.evaluate.figures import (
    CYCLE,
    DASHES,
    INK,
    MARKERS,
    SERIES,
    WIDTH,
    legend_above,
    new_figure,
    panel_title,
    percent_axis,
)
from cloak_core.evaluate.report.words import short_name
from cloak_core.scene.logos.logo import area_share

SINGLE, MULTI = "0", "-10:10:5"
"""Training angles of the paper."""
PAPER_TABLE = [
    {"detector": "YOLOv2", "logo": "none", "single": 0.01, "multi": 0.01},
    {"detector": "YOLOv2", "logo": "letter G", "single": 0.98, "multi": 0.86},
    {"detector": "YOLOv2", "logo": "smiley", "single": 0.98, "multi": 0.88},
    {"detector": "YOLOv2", "logo": "chest + thighs", "single": 0.99, "multi": 0.93},
    {"detector": "Faster R-CNN", "logo": "none", "single": 0.01, "multi": 0.01},
    {"detector": "Faster R-CNN", "logo": "letter G", "single": 0.68, "multi": 0.62},
    {"detector": "Faster R-CNN", "logo": "smiley", "single": 0.51, "multi": 0.47},
    {"detector": "Faster R-CNN", "logo": "chest + thighs", "single": 0.99, "multi": 0.91},
]


def narrow_angles(lab: Lab) -> tuple[float, ...]:
    """The paper's test angles: 21 whole degrees in -10..10; every second one when quick."""
    return tuple(float(a) for a in range(-10, 11, 2 if lab.options.quick else 1))


def repeated(lab: Lab, faces: np.ndarray, specs: Sequence[str], **changes: object) -> list:
    """One training per seed."""
    return [lab.train(faces, specs, seed=seed, **changes) for seed in lab.options.seed_list]


def table1(lab: Lab) -> Outcome:
    """Letter G, smiley and chest + thighs against every detector, trained at one angle and at five."""
    rows, panels, curves, pictures = [], {}, {}, {}
    logos = paper_logos(lab.materials.bodies, lab.options.out / "table1")
    for spec in lab.specs:
        panels[spec] = []
        for name, faces in logos.items():
            for training, angles in (("single", SINGLE), ("multi", MULTI)):
                trained = repeated(lab, faces, [spec], angles=angles)
                result = lab.evaluate(trained, narrow_angles(lab), [spec])
                share = round(area_share(lab.materials.bodies, faces), 4)
                rows.append({"logo": name, "training": training, "area_share": share} | result.row(spec))
                panels[spec].append((name, training, result.rate(spec)))
                curves[spec] = result  # ends with chest + thighs, trained at five angles
        sheets = contact_sheets(lab, spec, trained[0], curves[spec], narrow_angles(lab))
        pictures |= {f"{name}-{file_name(spec)}": sheet for name, sheet in sheets.items()}
        none = curves[spec].rate(spec, "clothing")
        rows.append({"logo": "none", "training": "-", "detector": spec, "success": none.value, "low": none.low,
                     "high": none.high, "n": none.n})  # fmt: skip
    return Outcome(
        "Attack success by logo and training angles (table 1)",
        rows,
        _table1_words(lab, rows),
        {"success": _table1_figure(panels), "thresholds": _threshold_figure(curves)},
        PAPER_TABLE,
        pictures,
    )


def _table1_words(lab: Lab, rows: list[dict]) -> list[str]:
    words = [
        "Each logo was trained at azimuth 0 (single) and at -10, -5, 0, 5, 10 degrees (multi) and tested on unseen "
        f"bodies and backgrounds at {len(narrow_angles(lab))} azimuths in -10..10. Letter and smiley are scaled to the "
        "share of the body's area that the paper's have of its faces (4.4 %); chest + thighs is given at the paper's "
        "share (8.5 %, small) and whole."
    ]
    for spec in lab.specs:
        mine = [row for row in rows if row["detector"] == spec]
        best = best_row([row for row in mine if row["logo"] != "none"])
        none = next(row for row in mine if row["logo"] == "none")
        whole = next(r for r in mine if r["logo"] == "chest + thighs" and r["training"] == "multi")
        words.append(
            f"{short_name(spec)}, {lab.steps([spec])} steps: chest + thighs, multi-angle {said(whole)}; own clothing "
            f"{said(none)}; grey {rate_text(whole['grey'])}, random {rate_text(whole['random'])}, stripes "
            f"{rate_text(whole['stripes'])}, checks {rate_text(whole['checks'])} on the same images. The highest of "
            f"the table is {best['logo']}, {best['training']}-angle, at {rate_text(best['success'])} (the largest of "
            "several: read it as such)."
        )
    return words


def _table1_figure(panels: dict) -> object:
    names = list(dict.fromkeys(name for points in panels.values() for name, _, _ in points))
    figure, axes = new_figure(WIDTH, 0.9 + 0.42 * len(names), len(panels), sharey=True)
    for axis, (spec, points) in zip(axes, panels.items(), strict=True):
        looks = {"single": ("one angle", CYCLE[1], "s", -0.13), "multi": ("five angles", CYCLE[0], "o", 0.13)}
        for training, (label, color, marker, offset) in looks.items():
            mine = [(names.index(n), r) for n, t, r in points if t == training]
            _points(axis, mine, color, marker, offset, f"trained at {label}")
        panel_title(axis, short_name(spec), len(panels))
        _success_x(axis)
    axes[0].set_yticks(range(len(names)), names)
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    legend_above(figure)
    return figure


def _points(axis: object, points: list, color: str, marker: str, offset: float, label: str) -> None:
    at = np.array([y + offset for y, _ in points])
    value = np.array([r.value for _, r in points])
    error = np.clip(np.array([[r.value - r.low, r.high - r.value] for _, r in points]).T, 0, None)
    axis.errorbar(value, at, xerr=error, fmt=marker, color=color, lw=1.2, label=label, clip_on=False)


def _success_x(axis: object) -> None:
    axis.set_xlim(-0.02, 1.02)
    axis.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "25", "50", "75", "100 %"])
    axis.set_xlabel("attack success")
    axis.grid(axis="y", visible=False)


def _threshold_figure(curves: dict[str, Repeats]) -> object:
    figure, axes = new_figure(WIDTH, 2.7, len(curves), sharey=True)
    grid = np.linspace(0, 1, 101)
    for axis, (spec, result) in zip(axes, curves.items(), strict=True):
        d = result.specs.index(spec)
        for c, control in enumerate(result.controls):
            score = np.sort(np.concatenate([m.score[d, c] for m in result.measurements]))
            look = SERIES[control]
            share = np.searchsorted(score, grid, side="right") / len(score)
            axis.plot(grid, share, color=look.color, ls=look.dash, label=look.label)
        axis.axvline(THRESHOLD, color=INK, lw=0.8, ls=":", zorder=0)
        panel_title(axis, short_name(spec), len(curves))
        axis.set_xlabel("detection threshold")
    percent_axis(axes[0])
    legend_above(figure)
    return figure


def transfer(lab: Lab) -> Outcome:
    """Chest + thighs trained against each detector, tested on all of them."""
    faces = chest_thighs(lab.materials.bodies)
    rows, matrix = [], np.zeros((len(lab.specs), len(lab.specs)))
    for i, source in enumerate(lab.specs):
        result = lab.evaluate(repeated(lab, faces, [source], angles=MULTI), narrow_angles(lab))
        for j, target in enumerate(lab.specs):
            row = result.row(target)
            rows.append({"trained_on": source, "tested_on": row.pop("detector")} | row)
            matrix[i, j] = rows[-1]["success"]
    off = [row for row in rows if row["trained_on"] != row["tested_on"]]
    lengths = ", ".join(f"{short_name(spec)} ({lab.steps([spec])} steps)" for spec in lab.specs)
    words = [
        f"Chest + thighs was trained at five angles against each of {lengths} and shown to every other (black box)."
    ]
    if off:
        best = best_row(off)
        words.append(
            f"Between different detectors success lies between {rate_text(min(r['success'] for r in off))} and "
            f"{rate_text(best['success'])} (from {short_name(best['trained_on'])} to {short_name(best['tested_on'])})."
        )
    else:
        words.append("Only one detector was given, so there is no transfer to speak of: name several with --detector.")
    figures = {"matrix": _matrix_figure(matrix, lab.specs, rows)} if off else {}
    return Outcome("Transfer between detectors", rows, words, figures)


def _matrix_figure(matrix: np.ndarray, specs: Sequence[str], rows: list[dict]) -> Figure:
    """Success by detector trained on and tested on; below it what the same images say of two controls."""
    names = [short_name(spec).replace(" ", "\n") for spec in specs]
    controls = ("random", "clothing")
    tested = {row["tested_on"]: row for row in rows}  # controls wear nothing trained: alike under every source
    shown = np.vstack([matrix, [[tested[spec][control] for spec in specs] for control in controls]])
    figure, (axis,) = new_figure(2.6 + 0.9 * len(names), 1.3 + 0.6 * len(shown))
    image = axis.imshow(shown, cmap="cividis", vmin=0, vmax=1, aspect="auto")
    axis.grid(visible=False)
    for (i, j), value in np.ndenumerate(shown):
        axis.text(j, i, f"{100 * value:.0f}", ha="center", va="center", color="black" if value > 0.55 else "white")
    axis.axhline(len(names) - 0.5, color="white", lw=3)
    axis.set_xticks(range(len(names)), names, rotation=30, ha="right", rotation_mode="anchor")
    axis.set_yticks(range(len(shown)), names + [SERIES[control].label for control in controls])
    axis.set_xlabel("tested on")
    axis.set_ylabel("trained on")
    figure.colorbar(image, ax=axis, shrink=0.8, label="attack success", format=lambda v, _: f"{100 * v:.0f} %")
    return figure


def shape(lab: Lab) -> Outcome:
    """Success against logo area for a family of shapes, one detector."""
    spec = lab.specs[0]
    bodies = lab.materials.bodies
    rows = []
    for name, faces in shapes(bodies, lab.options.out / "shape", lab.options.quick).items():
        result = lab.evaluate(repeated(lab, faces, [spec], angles=MULTI), narrow_angles(lab), [spec])
        family = name.rpartition(" ")[0]
        rows.append({"shape": family, "area_share": round(area_share(bodies, faces), 4)} | result.row(spec))
    figure, (axis,) = new_figure()
    for k, family in enumerate(dict.fromkeys(row["shape"] for row in rows)):
        mine = sorted((r for r in rows if r["shape"] == family), key=lambda r: r["area_share"])
        x, y = [100 * r["area_share"] for r in mine], [r["success"] for r in mine]
        error = np.clip([[r["success"] - r["low"] for r in mine], [r["high"] - r["success"] for r in mine]], 0, None)
        axis.errorbar(
            x, y, error, color=CYCLE[k % 7], marker=MARKERS[k % 7], ls=DASHES[k % 7], lw=1.4, capsize=2, label=family
        )
    percent_axis(axis)
    axis.set_xlabel("share of the body's area (%)")
    legend_above(figure)
    words = [
        f"Shapes stamped on the chest at growing size, trained at five angles against {short_name(spec)}.",
        f"The smallest ({rate_text(min(r['area_share'] for r in rows))} of the area) reaches "
        f"{said(min(rows, key=lambda r: r['area_share']))}, the largest "
        f"{said(max(rows, key=lambda r: r['area_share']))}.",
    ]
    return Outcome("Success by shape and area", rows, words, {"area": figure})
