"""What an evaluation measured, as a program gets it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("success", "success_own", "success_iou", "conditional", "renamed", "gone", "ap50", "n")
"""Figures of an S of contract C6 that are one number each."""


class Figures(dict):
    """The record that `cloak evaluate --json` or `cloak wear --json` prints, with its rates as a table."""

    def to_frame(self) -> pd.DataFrame:
        """Make a table with a row for each detector and what is worn: rates in [0, 1], bounds of the 95 % interval, n.

        "logo" are the colours that were judged; "clothing", "grey", "random" and the like are controls.
        """
        import pandas as pd

        rows = []
        for spec, judged in self["detectors"].items():
            for worn, rates in judged.items():
                if isinstance(rates, dict) and "success" in rates and "ci95" in rates:
                    low, high = rates["ci95"]
                    row = {"detector": spec, "worn": worn, "low": low, "high": high}
                    rows.append(row | {name: rates[name] for name in COLUMNS if name in rates})
        return pd.DataFrame(rows)
