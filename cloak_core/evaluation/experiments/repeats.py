"""The repetitions of one training, evaluated on the same images: pooled rates with intervals, and their spread."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from cloak_core.detectors.scoring import THRESHOLD
from cloak_core.evaluation.controls import CLOTHING, LOGO, STANDARD
from cloak_core.evaluation.intervals import Rate, clustered_rate
from cloak_core.evaluation.measurement import Measurement
from cloak_core.evaluation.rates import average_precision, threshold_curves

CURVES = "curves"
"""Of a row: success by threshold, logo and controls. No column: `write_numbers` makes a table of its own of them."""


class Repeats:
    """One measurement per seed, all with the same trials."""

    def __init__(self, measurements: Sequence[Measurement]) -> None:
        self.measurements = list(measurements)
        first = self.measurements[0]
        self.specs, self.controls, self.trials = first.specs, first.controls, first.trials

    def rate(
        self,
        spec: str,
        control: str = LOGO,
        *,
        threshold: float = THRESHOLD,
        on_body: bool = False,
        **where: float | int,
    ) -> Rate:
        """Success, over all repetitions, of the images at this angle, distance or pose (columns of the trials)."""
        d, c = self.specs.index(spec), self.controls.index(control)
        # Standard controls look alike whatever was trained: repeating their images tells nothing new.
        told = self.measurements[:1] if control in STANDARD else self.measurements
        hits = [(m.score_on if on_body else m.score)[d, c] <= threshold for m in told]
        return self._pooled(hits, self._where(**where))

    def _pooled(self, hits: Sequence[Bool[np.ndarray, N]], where: Bool[np.ndarray, N]) -> Rate:
        """The share of hits of all repetitions among the images of `where`."""
        count, images = len(hits), int(where.sum())
        bodies, backgrounds = (np.tile(way[where], count) for way in (self.trials.pose, self.trials.background))
        seeds = np.repeat(np.arange(count), images)
        return clustered_rate(np.concatenate([hit[where] for hit in hits]), bodies, backgrounds, seeds)

    def _where(self, **values: float | int) -> Bool[np.ndarray, N]:
        where = np.ones(len(self.trials), bool)
        for column, value in values.items():
            where &= np.isclose(getattr(self.trials, column), value)
        return where

    def share(self, spec: str, control: str, **values: float) -> float:
        """`rate` without its interval."""
        d, c, where = self.specs.index(spec), self.controls.index(control), self._where(**values)
        return float(np.mean([m.score[d, c, where] <= THRESHOLD for m in self.measurements]))

    def curves(self, spec: str) -> dict[str, list[float]]:
        """Success of logo and controls at every one of `THRESHOLDS`, over all repetitions."""
        each = [threshold_curves(m, self.specs.index(spec)) for m in self.measurements]
        return {
            control: [round(float(np.mean([curve[t][control] for curve in each])), 4) for t in each[0]]
            for control in self.controls
        }

    def spread(self, spec: str) -> list[float]:
        """Success of each repetition."""
        d = self.specs.index(spec)
        return [round(float((m.score[d, 0] <= THRESHOLD).mean()), 6) for m in self.measurements]

    def conditional(self, spec: str) -> Rate:
        """Success where the same image in own clothing is detected."""
        d, clean = self.specs.index(spec), self.controls.index(CLOTHING)
        found = self.measurements[0].score[d, clean] > THRESHOLD
        return self._pooled([m.score[d, 0] <= THRESHOLD for m in self.measurements], found)

    def rate_row(self, spec: str, control: str = LOGO, **where: float) -> dict:
        """Success, rounded, with its interval and count."""
        rate = self.rate(spec, control, **where)
        return rounded({"success": rate.value, "low": rate.low, "high": rate.high, "n": rate.n})

    def rows_at(self, spec: str, column: str, values: Sequence[float], **where: float) -> list[dict]:
        """One row per angle or distance: success with interval, every control beside it."""
        rows = []
        for value in values:
            place = where | {column: value}
            shares = {control: self.share(spec, control, **place) for control in self.controls[1:]}
            rows.append({"detector": spec, column: value} | self.rate_row(spec, **place) | rounded(shares))
        return rows

    def row(self, spec: str) -> dict:
        """Everything a table says about these repetitions under one detector: plain numbers, ready for CSV."""
        d, first, spread = self.specs.index(spec), self.measurements[0], self.spread(spec)
        clean = first.controls.index(CLOTHING)
        more = {
            "success_iou": self.rate(spec, on_body=True).value,
            "conditional": self.conditional(spec).value,
            # Does not stop at 0 or 100 % where success does.
            "mean_score": float(np.mean([m.score[d, 0] for m in self.measurements])),
        }
        more |= {control: self.share(spec, control) for control in self.controls[1:]}
        more |= {
            "clean_detection": 1 - more[CLOTHING],
            "average_precision": float(np.mean([average_precision(m, d, 0) for m in self.measurements])),
            "clean_average_precision": average_precision(first, d, clean),
            "false_alarms": float((first.bare[d] > THRESHOLD).mean()),
            "seeds": len(spread),
            "worst_seed": min(spread),
            "best_seed": max(spread),
        }
        return {"detector": spec} | self.rate_row(spec) | rounded(more) | {CURVES: self.curves(spec)}


def rounded(row: dict) -> dict:
    """Four digits for numbers, None for those that are none."""
    numbers = {key: value for key, value in row.items() if isinstance(value, float)}
    return row | {key: None if np.isnan(value) else round(value, 4) for key, value in numbers.items()}
