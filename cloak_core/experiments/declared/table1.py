"""Table 1: letter G, smiley and chest + thighs against every detector, trained at one angle and at five."""

from __future__ import annotations

from cloak_core.experiments.declaration import MULTI, SINGLE, Bars, Cell, Cells, Experiment, RunStore, Thresholds
from cloak_core.experiments.logos import paper_logos

WHOLE = {"logo": "chest + thighs", "training": "multi"}
"""The row whose thresholds are shown."""
PAPER = (
    {"detector": "YOLOv2", "logo": "none", "single": 0.01, "multi": 0.01},
    {"detector": "YOLOv2", "logo": "letter G", "single": 0.98, "multi": 0.86},
    {"detector": "YOLOv2", "logo": "smiley", "single": 0.98, "multi": 0.88},
    {"detector": "YOLOv2", "logo": "chest + thighs", "single": 0.99, "multi": 0.93},
    {"detector": "Faster R-CNN", "logo": "none", "single": 0.01, "multi": 0.01},
    {"detector": "Faster R-CNN", "logo": "letter G", "single": 0.68, "multi": 0.62},
    {"detector": "Faster R-CNN", "logo": "smiley", "single": 0.51, "multi": 0.47},
    {"detector": "Faster R-CNN", "logo": "chest + thighs", "single": 0.99, "multi": 0.91},
)


def cells(store: RunStore) -> Cells:
    bodies = store.split.bodies
    logos = paper_logos(bodies, store.options.out / "table1")
    for spec in store.specs:
        for name, faces in logos.items():
            for training, angles in (("single", SINGLE), ("multi", MULTI)):
                label = {"logo": name, "training": training}
                yield Cell(
                    label=label,
                    area=True,
                    faces=faces,
                    specs=[spec],
                    training={"angles": angles},
                    # Own clothing is the same beside every logo.
                    baseline={"logo": "none", "training": "-"} if label == WHOLE else None,
                )


EXPERIMENT = Experiment(
    title="Attack success by logo and training angles (table 1)",
    caption="Each logo is trained at azimuth 0 (single) and at -10, -5, 0, 5, 10 degrees (multi) and tested on unseen "
    "bodies and backgrounds at azimuths in -10..10. Letter and smiley are scaled to the share of the body's area that "
    "the paper's have of its faces (4.4 %); chest + thighs is given at the paper's share (8.5 %, small) and whole. "
    "Logo 'none' is own clothing on the same images. The highest of several rows is the largest of several: read it "
    "as such.",
    cells=cells,
    figures={
        "success": Bars(
            y="logo",
            series="training",
            panel="detector",
            labels={"single": "trained at one angle", "multi": "trained at five angles"},
        ),
        "thresholds": Thresholds(where=WHOLE, panel="detector"),
    },
    paper=PAPER,
    order=1,
)
