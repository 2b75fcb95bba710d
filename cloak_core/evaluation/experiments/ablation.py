"""The choices behind preset `best`: the same with one of them changed; the first detector."""

from __future__ import annotations

from matplotlib.figure import Figure

from cloak_core.evaluation.experiments.drawing import rate_bars, rates_along_x
from cloak_core.evaluation.experiments.lab import MULTI, SINGLE, Lab, times
from cloak_core.evaluation.experiments.numbers import Numbers, column
from cloak_core.evaluation.figures import CYCLE, new_figure
from cloak_core.evaluation.report.words import said, short_name

TITLE = "The choices behind preset best"
CHANGES: dict[str, dict[str, object]] = {
    "preset best": {},
    "SGD instead of Adam": {"optimizer": "sgd", "lr": 1.0, "momentum": 0.9},
    "learning rate 0.02 instead of 0.05": {"lr": 0.02},
    "learning rate 0.1 instead of 0.05": {"lr": 0.1},
    "constant learning rate": {"schedule": "constant"},
    "loss: score": {"loss": "score"},
    "loss: objectness": {"loss": "objectness"},
    "loss: log": {"loss": "log"},
    "ten best boxes": {"reduce": "topk"},
    "no total variation": {"tv_weight": 0.0},
    "no photometric noise": {"contrast": "1", "brightness": "0", "noise": 0.0},
    "the paper's photometric range": {"contrast": "0:1", "brightness": "0:1"},
    "no translation": {"translation": 0},
    "one angle": {"angles": SINGLE},
    "from random colours": {"initial": "random"},
    "sigmoid instead of projection": {"gamut": "sigmoid"},
    "half of the images: hard views": {"hard_views": 0.5},
    "occluders, zoom, blur and JPEG": {"occluders": 2, "zoom": "0.8:1.2", "blur": 1.0, "jpeg": "40:95"},
}
"""Each changes one choice of preset `best`."""
FULL = (
    "constant learning rate",
    "loss: objectness",
    "ten best boxes",
    "the paper's photometric range",
    "no translation",
    "from random colours",
    "sigmoid instead of projection",
)
"""Left out when quick."""


def measure(lab: Lab) -> Numbers:
    spec, rows = lab.specs[0], []
    for name, change in CHANGES.items():
        if not (lab.options.quick and name in FULL):
            changes = {"preset": "best", "angles": MULTI} | change
            trained = lab.chest_thighs(spec, **changes)
            rows.append({"change": name} | times(trained) | lab.evaluate(trained, lab.angles, [spec]).row(spec))
    return Numbers(rows)


def tell(numbers: Numbers) -> list[str]:
    rows, best = numbers.rows, numbers.rows[0]
    by_success = sorted(rows, key=lambda row: row["success"])
    by_score = sorted(rows, key=lambda row: row["mean_score"])
    (worst, highest), (low, high) = (by_success[0], by_success[-1]), (by_score[0], by_score[-1])
    return [
        f"Chest + thighs against {short_name(best['detector'])}: preset best reaches {said(best)}. Each line changes "
        "one choice, with the same number of steps.",
        f"The lowest is '{worst['change']}', {said(worst)}, the highest '{highest['change']}', {said(highest)}. The "
        f"mean score of the surest person, where less is better, lies between {low['mean_score']:.3f} "
        f"('{low['change']}') and {high['mean_score']:.3f} ('{high['change']}'); preset best has "
        f"{best['mean_score']:.3f}. Differences within the intervals say nothing.",
    ]


def draw(numbers: Numbers) -> dict[str, Figure]:
    rows = numbers.rows
    figure, (axis,) = new_figure(height=0.7 + 0.26 * len(rows))
    rates_along_x(axis, column(rows, "change"))
    axis.axvline(rows[0]["success"], color=CYCLE[6], lw=0.8, ls="--")
    rate_bars(axis, rows, range(len(rows)), CYCLE[0])
    return {"changes": figure}
