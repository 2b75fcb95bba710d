"""Defences under attack: what each is worth against cloaks that know it, and against those that do not."""

from __future__ import annotations

from functools import partial

from cloak_core.core.black_box import queries_after
from cloak_core.core.evaluation.controls import STANDARD
from cloak_core.detectors.defended.detector import defend
from cloak_core.detectors.defended.table import read_head
from cloak_core.experiments.declaration import MULTI, Bars, Cell, Cells, Experiment, RunStore
from cloak_core.experiments.tables import beats_adaptive

DEFENCES = ("jpeg=75", "blur=1", "median=3", "bits=4", "resize-pad", "entropy-mask", "segment")
NONE = "none"
COLUMNS = ("operating_point", "success_own", "own_low", "own_high", "ap50", "clean_ap50", "clean_recall")
COLUMNS += ("clean_recall_own", "random", "false_alarms", "seeds")


def cells(store: RunStore) -> Cells:
    heads = store.options.defence or DEFENCES
    for head in heads:
        read_head(head, f"{head}:{store.specs[0]}")  # before anything is trained
    for spec in store.specs:
        plain = store.split.detectors[spec]
        behind = {NONE: spec} | {head: f"{head}:{spec}" for head in heads}
        defended = store.with_detectors({behind[head]: defend(plain, head) for head in heads})
        length = {"angles": MULTI, "steps": store.steps([spec], angles=MULTI)}
        batch = store.train_settings(specs=[spec], angles=MULTI).run.batch
        # The search shows the detector as many images as a training does.
        queries = max(length["steps"] * batch, queries_after(1, batch))
        others = [other for other in store.specs if other != spec]
        for head, judge in behind.items():
            attacks = {"naive": ([spec], {}), "adaptive": ([judge], {})}
            attacks |= {"transferred": (others, {})} if others else {}
            attacks |= {"random search": ([judge], {"black_box_queries": queries})}
            for attack, (trained_on, changes) in attacks.items():
                yield Cell(
                    label={"detector": spec, "defence": head, "attack": attack},
                    specs=trained_on,
                    training=length | changes,
                    judges=[judge],
                    test={"controls": STANDARD},
                    columns=COLUMNS,
                    store=defended,
                )


EXPERIMENT = Experiment(
    title="Defences, attacked by cloaks that know them and by others",
    caption="Chest + thighs, judged on unseen bodies and backgrounds at azimuths in -10..10. Naive: trained on the "
    "detector without the defence; adaptive: trained on the detector behind it, through BPDA or in expectation; "
    "transferred: trained on the other detectors, none of them defended; random search: made from the defended "
    "detector's answers alone. A defence is worth what is left of it under the attack that knows it. Where another "
    "attack beats the adaptive one (by more than its interval), the gradient is a poor guide through this defence and "
    "the adaptive figure too kind; where that is so without a defence, the attack is too short to judge one by.",
    cells=cells,
    figures={"defences": Bars(y="defence", series="attack", panel="detector")},
    finish=partial(beats_adaptive, same=("detector", "defence")),
    order=13,
)
