"""Detectors before and after hardening: under new cloaks that know them, and whether that gradient can be trusted.

A detector that merely hides its gradient looks robust to who follows it (Athalye et al., ICML 2018). Three signs give
it away: an attack without gradients or one made on another detector does better, and a longer attack does not help.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import chain

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cloak_core.attack.black_box import queries_after
from cloak_core.detectors import THRESHOLD
from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.experiments.drawing import band, errors, look
from cloak_core.evaluation.experiments.lab import MULTI, Lab
from cloak_core.evaluation.experiments.logos import chest_thighs, shirt_trousers
from cloak_core.evaluation.experiments.numbers import Numbers, Rows, group, select
from cloak_core.evaluation.experiments.repeats import Repeats, rounded
from cloak_core.evaluation.figures import INK, WIDTH, legend_above, new_figure, percent_axis
from cloak_core.evaluation.rates import average_precision
from cloak_core.evaluation.report.words import interval, percent, said, short_names

TITLE = "Detectors before and after hardening, under cloaks trained anew against each"
LEAST_IMAGES = 300
"""Of each evaluation: a difference of two points in clean recall is to be seen."""
SHARES = (0.25, 0.5)
"""Of the attack's length: shorter ones. The first of several detectors is what the others are held against: it gets
neither these nor a search, and no larger logo."""
CHEST, SHIRT = "chest + thighs", "shirt + trousers"
ADAPTIVE, TRANSFERRED, SEARCH = "adaptive", "transferred", "random search"


def measure(lab: Lab) -> Numbers:
    bodies, rows = lab.materials.bodies, []
    logos = {CHEST: chest_thighs(bodies), SHIRT: shirt_trousers(bodies)}
    steps = {spec: lab.steps([spec], angles=MULTI) for spec in lab.specs}
    for k, spec in enumerate(lab.specs):
        reference = k == 0 and len(lab.specs) > 1
        batch = lab.train_settings(specs=[spec], angles=MULTI).run.batch
        queries = max(steps[spec] * batch, queries_after(1, batch))
        wanted = [(CHEST, ADAPTIVE, spec, {"steps": steps[spec]})]
        others = [other for other in lab.specs if other != spec]
        wanted += [(CHEST, TRANSFERRED, other, {"steps": steps[other]}) for other in others]
        if not reference:
            wanted += [(SHIRT, ADAPTIVE, spec, {"steps": steps[spec]})]
            wanted += [(CHEST, ADAPTIVE, spec, {"steps": max(1, round(share * steps[spec]))}) for share in SHARES]
            wanted += [(CHEST, SEARCH, spec, {"steps": steps[spec], "black_box_queries": queries})]
        for logo, attack, made_on, changes in wanted:
            trained = lab.repeat(logos[logo], [made_on], angles=MULTI, **changes)
            result = lab.evaluate(trained, lab.angles, [spec], controls=(CLOTHING,), images_per_view=_images(lab))
            label = {"detector": spec, "logo": logo, "attack": attack, "trained_on": made_on}
            label["steps"] = changes["steps"]
            rows.append(label | _rates(result, spec, lab.materials.detectors[spec].operating_point))
    return Numbers(rows, {"angles": len(lab.angles)}, counts={"images_per_view": _images(lab)})


def _images(lab: Lab) -> int:
    """Images of each unseen body at each azimuth."""
    views = lab.materials.unseen.pose_count * len(lab.angles)
    return max(lab.options.test_images, math.ceil(LEAST_IMAGES / views))


def _rates(result: Repeats, spec: str, point: float) -> dict:
    """Success at 0.6 and at the detector's own point, and what the detector does without any cloak."""
    d, first = result.specs.index(spec), result.measurements[0]
    own = result.rate(spec, threshold=point)
    more = {
        "success_own": own.value,
        "own_low": own.low,
        "own_high": own.high,
        "clean_recall": 1 - result.rate(spec, CLOTHING).value,
        "clean_recall_own": 1 - result.rate(spec, CLOTHING, threshold=point).value,
        "clean_ap50": average_precision(first, d, first.controls.index(CLOTHING)),
        "false_alarms": float((first.bare[d] > THRESHOLD).mean()),
        "false_alarms_own": float((first.bare[d] > point).mean()),
        "mean_score": float(np.mean([m.score[d, 0] for m in result.measurements])),
    }
    return result.rate_row(spec) | rounded(more) | {"seeds": len(result.measurements)}


def tell(numbers: Numbers) -> list[str]:
    words = [
        f"Cloaks are trained against each detector itself and judged on unseen bodies and backgrounds at "
        f"{numbers.facts['angles']} azimuths in -10..10; clean recall is that of the same images in own clothing."
    ]
    names = _names(numbers)
    return words + [f"{names[spec]}: {_of_one(rows, names)}" for spec, rows in group(numbers.rows, "detector").items()]


def _of_one(rows: Rows, names: Mapping[str, str]) -> str:
    chest = _attacks(rows, CHEST)
    last = chest[-1]
    hidden = [
        f"on {row['logo']} {said(row)}, at its own threshold {percent(row['success_own'])}"
        for row in (last, *select(rows, logo=SHIRT))
    ]
    parts = [
        f"a new cloak hides, {'; '.join(hidden)}. Clean recall {percent(last['clean_recall'])} (at its own threshold "
        f"{percent(last['clean_recall_own'])}), AP50 {last['clean_ap50']:.3f}, false alarms "
        f"{percent(last['false_alarms'])} ({percent(last['false_alarms_own'])})."
    ]
    if len(chest) > 1:
        curve = ", ".join(f"{percent(row['success'])} ({row['steps']})" for row in chest)
        parts.append(f"By the attack's steps: {curve}.")
    others = [row for row in rows if row["attack"] in (TRANSFERRED, SEARCH)]
    if others:
        parts.append("; ".join(_other(row, names) for row in others) + ".")
    if suspects := [row for row in (*others, *chest[:-1]) if row["success"] > last["high"]]:
        worst = max(suspects, key=lambda row: row["success"])
        parts.append(
            f"The strongest is {_other(worst, names)}, clearly above the longest adaptive one: its gradient is a poor "
            "guide, and the adaptive figure is too kind."
        )
    return " ".join(parts)


def _other(row: dict, names: Mapping[str, str]) -> str:
    made = f" from {names[row['trained_on']]}" if row["attack"] == TRANSFERRED else ""
    bounds = interval([row["low"], row["high"]])
    return f"{row['attack']}{made}, {row['steps']} steps: {percent(row['success'])} ({bounds})"


def draw(numbers: Numbers) -> dict[str, Figure]:
    by_detector = group(numbers.rows, "detector")
    names = _names(numbers)
    figure, (axis,) = new_figure(WIDTH, 3.0)
    for k, (spec, rows) in enumerate(by_detector.items()):
        chest = _attacks(rows, CHEST)
        band(axis, [float(row["steps"]) for row in chest], chest, names[spec], **look(k))
        for row in select(rows, attack=SEARCH):
            label = f"{names[spec]}, random search"
            axis.plot([row["steps"]], [row["success"]], ls="", marker="x", color=look(k)["color"], label=label)
    percent_axis(axis)
    axis.set_xlabel(f"updates of a new cloak on {CHEST} (random search: as many images)")
    legend_above(figure)
    return {"steps": figure} | ({"trade": _trade(by_detector, names)} if len(by_detector) > 1 else {})


def _names(numbers: Numbers) -> dict[str, str]:
    return short_names(row[key] for row in numbers.rows for key in ("detector", "trained_on"))


def _attacks(rows: Rows, logo: str) -> Rows:
    """The adaptive attacks on a logo, the longest last."""
    return sorted(select(rows, logo=logo, attack=ADAPTIVE), key=lambda row: row["steps"])


def _trade(by_detector: dict[str, Rows], names: Mapping[str, str]) -> Figure:
    """What robustness costs: success of the longest adaptive attacks against clean recall and against false alarms, a
    point for each detector, open for the larger logo."""
    figure, axes = new_figure(WIDTH, 3.0, 2, sharey=True)
    for axis, key, words in zip(axes, ("clean_recall", "false_alarms"), ("clean recall", "false alarms"), strict=True):
        for k, (spec, rows) in enumerate(by_detector.items()):
            color, marker = look(k)["color"], look(k)["marker"]
            for logo, filling in ((CHEST, color), (SHIRT, "none")):
                label = names[spec] if logo == CHEST else None
                for row in _attacks(rows, logo)[-1:]:
                    shape = {"fmt": marker, "color": color, "mfc": filling, "label": label, "lw": 1.2}
                    axis.errorbar([row[key]], [row["success"]], yerr=errors([row]), clip_on=False, **shape)
        values = [row[key] for row in chain.from_iterable(by_detector.values())]
        axis.set_xlim(max(0, min(values) - 0.01), min(1, max(values) + 0.01))  # so that a hair's breadth looks like one
        axis.xaxis.set_major_formatter(lambda share, _: f"{100 * share:g} %")
        axis.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        axis.set_xlabel(f"{words} at {THRESHOLD:g}")
    axes[0].plot([], [], ls="", marker="o", mfc="none", color=INK, label=f"on {SHIRT}")
    percent_axis(axes[0])
    legend_above(figure)
    return figure
