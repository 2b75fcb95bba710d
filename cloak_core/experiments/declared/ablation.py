"""The choices behind preset `best`: the same with one of them changed; the first detector."""

from __future__ import annotations

from cloak_core.experiments.declaration import MULTI, SINGLE, Bars, Cell, Cells, Experiment, RunStore

CHANGES: dict[str, dict[str, object]] = {
    "preset best": {},
    "SGD instead of Adam": {"optimizer": "sgd", "lr": 1.0, "momentum": 0.9},
    "learning rate 0.02 instead of 0.05": {"lr": 0.02},
    "learning rate 0.1 instead of 0.05": {"lr": 0.1},
    "constant learning rate": {"schedule": "constant"},
    "loss: score": {"loss": "score"},
    "loss: objectness": {"loss": "objectness"},
    "loss: log": {"loss": "log"},
    "no total variation": {"tv_weight": 0.0},
    "no photometric noise": {"contrast": "1", "brightness": "0", "noise": 0.0},
    "the paper's photometric range": {"contrast": "0:1", "brightness": "0:1"},
    "no translation": {"translation": 0},
    "one angle": {"angles": SINGLE},
    "from random colours": {"initial": "random"},
    "sigmoid instead of projection": {"gamut": "sigmoid"},
}
"""Each changes one choice of preset `best`."""
FULL = ("constant learning rate", "loss: objectness", "the paper's photometric range")
FULL += ("no translation", "from random colours", "sigmoid instead of projection")
"""Left out when quick."""


def cells(store: RunStore) -> Cells:
    for name, change in CHANGES.items():
        if not (store.options.quick and name in FULL):
            yield Cell(label={"change": name}, training={"preset": "best", "angles": MULTI} | change, timed=True)


EXPERIMENT = Experiment(
    title="The choices behind preset best",
    caption="Chest + thighs against the first detector. Each row changes one choice of preset best, with the same "
    "number of steps. Differences within the intervals say nothing. Mean score: of the surest person, where less is "
    "better.",
    cells=cells,
    figures={"changes": Bars(y="change")},
    order=9,
)
