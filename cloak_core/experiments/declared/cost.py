"""Success against training time: samples per pixel, the detector's precision, views kept or made for each image."""

from __future__ import annotations

from cloak_core.experiments.declaration import MULTI, Cell, Cells, Experiment, Lines, RunStore

VARIANTS: dict[str, dict[str, object]] = {
    "exact area, float32, views kept": {},
    "1 sample per pixel": {"samples": 1},
    "detector in bfloat16": {"precision": "bfloat16"},
    "a new view for every image": {"angle_jitter": 2.5},
    "4 samples per pixel": {"samples": 4},
    "16 samples per pixel": {"samples": 16},
    "64 samples per pixel": {"samples": 64},
}
"""What a training can save on; each changes the first."""
QUICK = 4
"""How many variants are measured when quick."""


def cells(store: RunStore) -> Cells:
    full = store.steps(angles=MULTI)
    quick = store.options.quick
    for name, changes in list(VARIANTS.items())[: QUICK if quick else None]:
        for steps in sorted({max(1, full // divisor) for divisor in ((3, 1) if quick else (4, 2, 1))}):
            yield Cell(
                label={"variant": name, "steps": steps},
                training={"angles": MULTI, "steps": steps} | changes,
                timed=True,
            )


EXPERIMENT = Experiment(
    title="Success against cost",
    caption="Chest + thighs against the first detector; every cloak is tested with the renderer's default. Processor "
    "time, all threads, is shown because wall-clock time also counts what others do on the machine. Differences "
    "within the intervals say nothing.",
    cells=cells,
    figures={"cost": Lines(x="cpu_seconds", series="variant", interval="bars", log=True)},
    order=11,
)
