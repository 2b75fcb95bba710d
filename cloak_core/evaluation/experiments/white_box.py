"""White box: each detector's own cloaks, at the paper's threshold and at the detector's own operating point."""

from __future__ import annotations

from matplotlib.figure import Figure

from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.controls import CLOTHING, STANDARD
from cloak_core.evaluation.experiments.drawing import errors, rates_along_x
from cloak_core.evaluation.experiments.lab import MULTI, Lab, times
from cloak_core.evaluation.experiments.logos import chest_thighs, shirt_trousers
from cloak_core.evaluation.experiments.numbers import Numbers, column, group
from cloak_core.evaluation.experiments.repeats import Repeats, rounded
from cloak_core.evaluation.figures import CYCLE, WIDTH, legend_above, new_figure, panel_title
from cloak_core.evaluation.rates import average_precision
from cloak_core.evaluation.report.words import interval, percent, said, short_name
from cloak_core.scene.logos.logo import area_share

TITLE = "White box on each detector, at 0.6 and at its own operating point"
IMAGES_PER_VIEW = 4
"""With four unseen bodies at 21 angles: 336 images."""


def measure(lab: Lab) -> Numbers:
    bodies, rows, facts = lab.materials.bodies, [], {"angles": len(lab.angles), "training_angles": MULTI}
    images = lab.options.images_per_view or (2 if lab.options.quick else IMAGES_PER_VIEW)
    for spec in lab.specs:
        for logo, faces in (("shirt + trousers", shirt_trousers(bodies)), ("chest + thighs", chest_thighs(bodies))):
            trained = lab.repeat(faces, [spec], angles=MULTI)
            result = lab.evaluate(trained, lab.angles, [spec], controls=STANDARD, images_per_view=images)
            point = lab.materials.detectors[spec].operating_point
            label = {"detector": spec, "logo": logo, "area_share": round(area_share(bodies, faces), 4)}
            spent = {"steps": lab.steps([spec], angles=MULTI)} | times(trained)
            rows.append(label | _rates(result, spec, point) | spent)
    return Numbers(rows, facts, counts={"images_per_view": images})


def _rates(result: Repeats, spec: str, point: float) -> dict:
    """Success at both thresholds with intervals, every control at both, and person AP50 with and without the cloak."""
    own = result.rate(spec, threshold=point)
    more = {"operating_point": point, "success_own": own.value, "own_low": own.low, "own_high": own.high}
    for control in STANDARD:
        more[control] = result.rate(spec, control).value
        more[f"{control}_own"] = result.rate(spec, control, threshold=point).value
    first, d = result.measurements[0], result.specs.index(spec)
    aps = [average_precision(one, d, 0) for one in result.measurements]
    more["ap50"] = sum(aps) / len(aps)
    more["clean_ap50"] = average_precision(first, d, first.controls.index(CLOTHING))
    more["false_alarms_own"] = float((first.bare[d] > point).mean())
    return result.rate_row(spec) | rounded(more) | {"seeds": len(result.measurements)}


def tell(numbers: Numbers) -> list[str]:
    words = [
        f"Each logo was trained at the angles {numbers.facts['training_angles']} and judged on unseen bodies and "
        f"photographs at {numbers.facts['angles']} azimuths in -10..10. Success: no person box above the threshold "
        "anywhere in the image, at the paper's 0.6 and at the confidence at which the detector is usually run."
    ]
    for spec, rows in group(numbers.rows, "detector").items():
        point = rows[0]["operating_point"]
        each = "; ".join(
            f"{row['logo']} {said(row)} at {THRESHOLD:g}, {percent(row['success_own'])} "
            f"({interval([row['own_low'], row['own_high']])}) at {point:g}"
            for row in rows
        )
        clothing = percent(max(row[CLOTHING] for row in rows))
        words.append(
            f"{short_name(spec)}, {rows[0]['steps']} steps: {each}. Own clothing {clothing} at {THRESHOLD:g} and "
            f"{percent(max(row['clothing_own'] for row in rows))} at {point:g}: what the clean detector misses."
        )
    return words


def draw(numbers: Numbers) -> dict[str, Figure]:
    panels = group(numbers.rows, "logo")
    names = [short_name(spec) for spec in group(numbers.rows, "detector")]
    figure, axes = new_figure(WIDTH, 1.0 + 0.42 * len(names), len(panels), sharey=True)
    for axis, (logo, rows) in zip(axes, panels.items(), strict=True):
        rates_along_x(axis, names)
        own = [{"success": r["success_own"], "low": r["own_low"], "high": r["own_high"]} for r in rows]
        for shown, marker, color, offset, label in (
            (rows, "o", CYCLE[0], -0.13, f"threshold {THRESHOLD:g}"),
            (own, "s", CYCLE[1], 0.13, "own operating point"),
        ):
            at = [k + offset for k in range(len(names))]
            axis.errorbar(column(shown), at, xerr=errors(shown), fmt=marker, color=color, lw=1.2, label=label)
        panel_title(axis, logo, len(panels))
    legend_above(figure)
    return {"success": figure}
