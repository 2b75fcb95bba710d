"""From where a cloak still works: unseen angles, wide angles, the full circle, distances."""

from __future__ import annotations

import numpy as np

from cloak_core.evaluate.experiments.attacks import MULTI, PAPER_TABLE, SINGLE, narrow_angles, repeated
from cloak_core.evaluate.experiments.lab import Lab
from cloak_core.evaluate.experiments.logos import chest_thighs, shirt_trousers
from cloak_core.evaluate.experiments.outcome import Outcome
from cloak_core.evaluate.experiments.repeats import Repeats
from cloak_core.evaluate.experiments.wording import rate_text, said_rate
from cloak_core.evaluate.figures import (
    CYCLE,
    DASHES,
    INK,
    MARKERS,
    SERIES,
    WIDTH,
    degree_ticks,
    legend_above,
    new_figure,
    percent_axis,
)
from cloak_core.evaluate.intervals import Rate
from cloak_core.evaluate.report.words import short_name

CIRCLE = "0:330:30"
"""Training angles all around."""
PAPER_WIDE = ((10, 0.93), (50, 0.0))
"""Up to this angle on YOLOv2, and where the curve ends."""
TRAINED_DISTANCE, DISTANCES = "1.4:3.0", tuple(round(1.4 + 0.2 * k, 1) for k in range(9))
FIVE_DISTANCES = (1.4, 1.8, 2.2, 2.6, 3.0)


def rate_rows(label: dict, result: Repeats, spec: str, column: str, values: tuple[float, ...]) -> list[dict]:
    """One row per angle or distance: success with interval, every control beside it."""
    return [label | {"detector": spec, column: value} | rate_row(result, spec, **{column: value}) for value in values]


def rate_row(result: Repeats, spec: str, **where: float) -> dict:
    """Success at some angle and distance with its interval, and every control's."""
    rate = result.rate(spec, **where)
    row = {"success": rate.value, "low": rate.low, "high": rate.high, "n": rate.n}
    row |= {control: result.share(spec, control, **where) for control in result.controls[1:]}
    return {key: round(value, 4) for key, value in row.items()}


def band(
    axis: object,
    x: tuple[float, ...],
    rates: list[Rate],
    color: str,
    marker: str,
    dash: object,
    label: str,
    alpha: float = 0.15,
) -> None:
    """A line of rates with its band of intervals."""
    axis.plot(x, [r.value for r in rates], color=color, marker=marker, ls=dash, label=label, clip_on=False, zorder=3)
    axis.fill_between(x, [r.low for r in rates], [r.high for r in rates], color=color, alpha=alpha, lw=0)


def single_angle(lab: Lab) -> Outcome:
    """Trained at azimuth 0 alone, tested at every whole degree around it."""
    faces, angles = chest_thighs(lab.materials.bodies), narrow_angles(lab)
    figure, (axis,) = new_figure()
    rows, whole = [], []
    words = ["Chest + thighs was trained at azimuth 0 alone and tested at unseen angles around it."]
    for k, spec in enumerate(lab.specs):
        result = lab.evaluate(repeated(lab, faces, [spec], angles=SINGLE), angles, [spec])
        whole.append({"angle": "all"} | result.row(spec))
        rows += rate_rows({}, result, spec, "angle", angles)
        rates = [result.rate(spec, angle=a) for a in angles]
        band(axis, angles, rates, CYCLE[k % 7], MARKERS[k % 7], DASHES[k % 7], short_name(spec))
        if not k:
            own = SERIES["clothing"]
            clean = [result.share(spec, "clothing", angle=a) for a in angles]
            axis.plot(angles, clean, color=INK, lw=1.2, ls=":", marker=own.marker, label=own.label)
        front, ends = result.rate(spec, angle=0.0), [result.rate(spec, angle=a) for a in (-10.0, 10.0)]
        words.append(
            f"{short_name(spec)}: {said_rate(result.rate(spec))} over all angles, {rate_text(front.value)} at 0, "
            f"{rate_text(ends[0].value)} at -10 and {rate_text(ends[1].value)} at 10 degrees; own clothing "
            f"{rate_text(result.rate(spec, 'clothing').value)}."
        )
    percent_axis(axis)
    axis.set_xlabel("azimuth (degrees)")
    degree_ticks(axis)
    legend_above(figure)
    paper = [
        {"detector": row["detector"], "success": row["single"]}
        for row in PAPER_TABLE
        if row["logo"] == "chest + thighs"
    ]
    return Outcome("Trained at one angle, tested at unseen ones", whole + rows, words, {"angles": figure}, paper)


def wide_angle(lab: Lab) -> Outcome:
    """Trained in -10..10 and all around, tested at -50..50 and all around; the first detector."""
    spec, bodies = lab.specs[0], lab.materials.bodies
    wide = tuple(float(a) for a in range(-50, 51, 10))
    circle = tuple(float(a) for a in range(0, 360, 20 if lab.options.quick else 15))
    kinds = {
        "chest + thighs, trained in ±10°": (chest_thighs(bodies), MULTI),
        "shirt + trousers, trained in ±10°": (shirt_trousers(bodies), MULTI),
        "shirt + trousers, trained all around": (shirt_trousers(bodies), CIRCLE),
    }
    figure, (axis,) = new_figure()
    around, polar = new_figure(WIDTH * 0.75, 4.2, subplot_kw={"projection": "polar"})
    rows, whole = [], []
    words = [
        f"Tested on {short_name(spec)}; the training all around has twice the steps. In the paper success decays "
        "towards 0 at ±50 degrees."
    ]
    for k, (name, (faces, angles)) in enumerate(kinds.items()):
        # All around there is more to learn: twice the steps.
        longer = {"steps": 2 * lab.steps(angles=angles)} if angles == CIRCLE else {}
        trained = repeated(lab, faces, [spec], angles=angles, **longer)
        look = (CYCLE[k], MARKERS[k], DASHES[k])
        results = [(part, lab.evaluate(trained, part, [spec])) for part in (wide, circle)]
        for (part, result), test in zip(results, ("-50..50", "circle"), strict=True):
            label = {"cloak": name, "test": test}
            whole.append(label | {"angle": "all"} | result.row(spec))
            rows += rate_rows(label, result, spec, "angle", part)
        band(axis, wide, [results[0][1].rate(spec, angle=a) for a in wide], *look, name, alpha=0.1)
        _ring(polar[0], circle, results[1][1], spec, "logo", look[0], look[2], name, banded=k == len(kinds) - 1)
        if k == len(kinds) - 1:
            own = SERIES["clothing"]
            clean = [results[0][1].share(spec, "clothing", angle=a) for a in wide]
            axis.plot(wide, clean, color=INK, lw=1.2, ls=":", marker=own.marker, label=own.label)
            _ring(polar[0], circle, results[1][1], spec, "clothing", INK, ":", own.label)
        words.append(
            f"{name}: {said_rate(results[0][1].rate(spec))} over -50..50 degrees, "
            f"{said_rate(results[1][1].rate(spec))} over the full circle."
        )
    percent_axis(axis)
    axis.set_xlabel("azimuth (degrees)")
    degree_ticks(axis)
    legend_above(figure)
    _compass(polar[0])
    around.legend(*polar[0].get_legend_handles_labels(), loc="outside upper left")
    paper = [{"cloak": "chest + thighs, trained in ±10°", "angle": f"±{a}", "success": s} for a, s in PAPER_WIDE]
    return Outcome("Wide angles and the full circle", whole + rows, words, {"wide": figure, "circle": around}, paper)


def _ring(
    axis: object,
    angles: tuple[float, ...],
    result: Repeats,
    spec: str,
    control: str,
    color: str,
    dash: object,
    name: str,
    banded: bool = False,
) -> None:
    """A closed line of rates around the body, with its band where asked for: on a circle only one can be read."""
    rates = [result.rate(spec, control, angle=a) for a in (*angles, angles[0])]
    at = np.radians([*angles, 360 + angles[0]])
    axis.plot(at, [r.value for r in rates], color=color, ls=dash, lw=1.8 if control == "logo" else 1.2, label=name)
    if banded:
        axis.fill_between(at, [r.low for r in rates], [r.high for r in rates], color=color, alpha=0.12, lw=0)


def _compass(axis: object) -> None:
    """A polar axis seen from above: front at the bottom, as the camera sees it at azimuth 0."""
    axis.set_theta_zero_location("S")
    axis.set_ylim(0, 1)
    axis.set_rlabel_position(135)
    axis.set_yticks([0.25, 0.5, 0.75, 1], ["", "50 %", "", "100 %"])
    axis.set_xticks(np.radians([0, 90, 180, 270]), ["front", "left", "back", "right"])


def distance(lab: Lab) -> Outcome:
    """Trained at 2.2 m or at distances drawn from 1.4..3.0, tested over distances and angles; the first detector."""
    spec, faces = lab.specs[0], chest_thighs(lab.materials.bodies)
    near = DISTANCES[::2] if lab.options.quick else DISTANCES
    angles = tuple(float(a) for a in range(-10, 11, 10 if lab.options.quick else 1))
    kinds = {"trained at 2.2 m": "2.2", "trained at 1.4 to 3.0 m": TRAINED_DISTANCE}
    figure, (axis,) = new_figure()
    by_angle, panels = new_figure(columns=2, sharey=True)
    rows, words = (
        [],
        [
            f"Single-angle training (azimuth 0) against {short_name(spec)}, as in the paper's appendix A; "
            "where distances are drawn, every image has its own (the paper draws one per batch)."
        ],
    )
    for k, (name, drawn) in enumerate(kinds.items()):
        trained = repeated(lab, faces, [spec], angles=SINGLE, distance=drawn)
        result = lab.evaluate(trained, (0.0,), [spec], distances=near, images_per_view=2 * lab.options.test_images)
        rows += rate_rows({"cloak": name}, result, spec, "distance", near)
        look = (CYCLE[2 * k], MARKERS[k], DASHES[k])  # blue and green: own clothing is orange
        band(axis, near, [result.rate(spec, distance=d) for d in near], *look, name)
        if not k:
            clean = [result.rate(spec, "clothing", distance=d).value for d in near]
            own = SERIES["clothing"]
            axis.plot(near, clean, color=own.color, ls=":", marker=own.marker, label=own.label)
        turned = lab.evaluate(trained, angles, [spec], distances=FIVE_DISTANCES)
        for j, d in enumerate(FIVE_DISTANCES):
            rates = [turned.rate(spec, angle=a, distance=d) for a in angles]
            # Without bands: those of five curves in one place hide each other. The intervals are in the table.
            line = [rate.value for rate in rates]
            panels[k].plot(angles, line, color=CYCLE[j], marker=MARKERS[j], ls=DASHES[j], label=f"{d} m", clip_on=False)
            rows += [
                {"cloak": name, "detector": spec, "distance": d, "angle": a}
                | rate_row(turned, spec, angle=a, distance=d)
                for a in angles
            ]
        panels[k].set_title(name)
        panels[k].set_xlabel("azimuth (degrees)")
        degree_ticks(panels[k])
        words.append(
            f"{name}: {said_rate(result.rate(spec))} over the distances, {said_rate(turned.rate(spec))} over angles."
        )
    percent_axis(axis)
    axis.set_xlabel("distance (m)")
    legend_above(figure)
    percent_axis(panels[0])
    legend_above(by_angle)
    return Outcome("Distance (appendix A)", rows, words, {"distance": figure, "angles": by_angle})
