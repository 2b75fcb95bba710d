"""Defences under attack: what each is worth against cloaks that know it, and against those that do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from cloak_core.attack.black_box import queries_after
from cloak_core.detectors import THRESHOLD
from cloak_core.detectors.defended.detector import defend
from cloak_core.detectors.defended.table import read_head
from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation.controls import CLOTHING, STANDARD
from cloak_core.evaluation.experiments.drawing import errors, rates_along_x
from cloak_core.evaluation.experiments.lab import MULTI, Lab, Trained
from cloak_core.evaluation.experiments.logos import chest_thighs
from cloak_core.evaluation.experiments.numbers import Numbers, Rows, column, group, select
from cloak_core.evaluation.experiments.repeats import Repeats, rounded
from cloak_core.evaluation.figures import CYCLE, MARKERS, WIDTH, legend_above, new_figure, panel_title
from cloak_core.evaluation.rates import average_precision
from cloak_core.evaluation.report.words import percent, said, short_name

TITLE = "Defences, attacked by cloaks that know them and by others"
DEFENCES = ("jpeg=75", "blur=1", "median=3", "bits=4", "resize-pad", "entropy-mask", "segment")
NONE = "none"
NAIVE, ADAPTIVE, TRANSFERRED, SEARCH = "naive", "adaptive", "transferred", "random search"
ATTACKS = {
    NAIVE: "trained on the detector without the defence",
    ADAPTIVE: "trained on the detector behind it, through BPDA or in expectation",
    TRANSFERRED: "trained on the other detectors, none of them defended",
    SEARCH: "made from the defended detector's answers alone",
}


def measure(lab: Lab) -> Numbers:
    given, rows, heads = lab.materials.detectors, [], lab.options.defence or DEFENCES
    for head in heads:
        read_head(head, f"{head}:{lab.specs[0]}")  # before anything is trained
    for spec in lab.specs:
        behind = {NONE: spec} | {head: f"{head}:{spec}" for head in heads}
        defended = {name: defend(given[spec], head) for head, name in behind.items() if head != NONE}
        mine = _lab_of(lab, given | defended)
        for head, name in behind.items():
            detector = mine.materials.detectors[name]
            for attack, trained in _cloaks(lab, mine, spec, name).items():
                result = mine.evaluate(trained, lab.angles, [name], controls=STANDARD)
                label = {"detector": spec, "defence": head, "attack": attack}
                rows.append(label | _rates(result, name, detector.operating_point))
    facts = {"steps": {spec: lab.steps([spec], angles=MULTI) for spec in lab.specs}, "angles": len(lab.angles)}
    return Numbers(rows, facts)


def _lab_of(lab: Lab, detectors: dict[str, Detector]) -> Lab:
    """The same lab with more detectors; how many steps is said with each training."""
    return Lab(replace(lab.materials, detectors=detectors), replace(lab.options, steps=()), lab.tell)


def _cloaks(lab: Lab, mine: Lab, spec: str, defended: str) -> dict[str, Sequence[Trained]]:
    """By attack, what was trained; the search shows the detector as many images as a training does."""
    faces, settings = chest_thighs(lab.materials.bodies), lab.train_settings(specs=[spec], angles=MULTI)
    length = {"angles": MULTI, "steps": lab.steps([spec], angles=MULTI)}
    queries = max(length["steps"] * settings.run.batch, queries_after(1, settings.run.batch))
    others = [other for other in lab.specs if other != spec]
    found = {NAIVE: mine.repeat(faces, [spec], **length), ADAPTIVE: mine.repeat(faces, [defended], **length)}
    found |= {TRANSFERRED: mine.repeat(faces, others, **length)} if others else {}
    return found | {SEARCH: mine.repeat(faces, [defended], black_box_queries=queries, **length)}


def _rates(result: Repeats, spec: str, point: float) -> dict:
    """Success at 0.6 and at the detector's own point; what the defence costs without any cloak beside it."""
    d, first = result.specs.index(spec), result.measurements[0]
    clean = first.controls.index(CLOTHING)
    own = result.rate(spec, threshold=point)
    more = {
        "operating_point": point,
        "success_own": own.value,
        "own_low": own.low,
        "own_high": own.high,
        "ap50": float(np.mean([average_precision(one, d, 0) for one in result.measurements])),
        "clean_ap50": average_precision(first, d, clean),
        "clean_recall": 1 - result.rate(spec, CLOTHING).value,
        "clean_recall_own": 1 - result.rate(spec, CLOTHING, threshold=point).value,
        "random": result.rate(spec, "random").value,
        "false_alarms": float((first.bare[d] > THRESHOLD).mean()),
    }
    return result.rate_row(spec) | rounded(more) | {"seeds": len(result.measurements)}


def tell(numbers: Numbers) -> list[str]:
    kinds = [f"{name}: {ATTACKS[name]}" for name in group(numbers.rows, "attack")]
    words = [
        f"Chest + thighs, judged on unseen bodies and backgrounds at {numbers.facts['angles']} azimuths in -10..10. "
        f"{'; '.join(kinds)}. A defence is worth what is left of it under the attack that knows it."
    ]
    for spec, rows in group(numbers.rows, "detector").items():
        bare = select(rows, defence=NONE, attack=ADAPTIVE)[0]
        better = _better(select(rows, defence=NONE))
        weak = (
            better and f" The attack is too short to judge a defence by: {better} does better even where there is none."
        )
        words.append(
            f"{short_name(spec)} without a defence: {said(bare)}, clean recall {percent(bare['clean_recall'])}.{weak}"
        )
        for head, mine in group(rows, "defence").items():
            if head != NONE:
                words.append(f"{head}: {_in_words(mine, bare, '' if better else _better(mine))}")
    return words


def _better(rows: Rows) -> str:
    """The strongest attack where it is clearly above the adaptive one, or ""."""
    adaptive, strongest = select(rows, attack=ADAPTIVE)[0], max(rows, key=lambda row: row["success"])
    return strongest["attack"] if strongest["success"] > adaptive["high"] else ""


def _in_words(rows: Rows, bare: dict, better: str) -> str:
    naive, adaptive = (select(rows, attack=attack)[0] for attack in (NAIVE, ADAPTIVE))
    rest = [f"{row['attack']} {percent(row['success'])}" for row in rows if row["attack"] not in (NAIVE, ADAPTIVE)]
    masked = better and (
        f" The strongest is {better}, clearly above the adaptive one: its gradient is not a good guide "
        "through this defence, and the adaptive figure is too kind."
    )
    others = f" ({', '.join(rest)})" if rest else ""
    cost = f"clean AP50 {adaptive['clean_ap50']:.3f} instead of {bare['clean_ap50']:.3f}"
    return (
        f"{percent(naive['success'])} when naive, {said(adaptive)} when it knows the defence{others}; {cost}.{masked}"
    )


def draw(numbers: Numbers) -> dict[str, Figure]:
    panels = group(numbers.rows, "detector")
    heads, attacks = list(group(numbers.rows, "defence")), list(group(numbers.rows, "attack"))
    figure, axes = new_figure(WIDTH, 1.2 + 0.5 * len(heads), len(panels), sharey=True)
    for axis, (spec, rows) in zip(axes, panels.items(), strict=True):
        rates_along_x(axis, heads)
        for k, attack in enumerate(attacks):
            mine = select(rows, attack=attack)
            at = [heads.index(row["defence"]) + 0.15 * (k - (len(attacks) - 1) / 2) for row in mine]
            look = {"fmt": MARKERS[k], "color": CYCLE[k], "label": attack}
            axis.errorbar(column(mine), at, xerr=errors(mine), lw=1.2, clip_on=False, **look)
        panel_title(axis, short_name(spec), len(panels))
    legend_above(figure)
    return {"defences": figure}
