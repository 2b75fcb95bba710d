"""Merge what `cloak wear --out` measured in folds of detectors left out into one record, with means and worst.

    python tools/merge_worn.py NAME=WORN/wear.json ... --about TEXT --out RECORD.json

RECORD.json has for each NAME: the people and photographs, how widths were chosen (`widths`, by picture without
folders), and for each detector and clothes the rates and their intervals; `means` and `worst` over its detectors.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from cloak_core.files.reading import read_json
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import write_json

RATES = ("success", "success_own", "gone", "gone_own")
KEPT = (*RATES, "ci95", "ci95_own", "n")


def rates_of(worn: dict) -> dict[str, dict]:
    """Pick what the record keeps, by detector and clothes."""
    return {
        without_folders(spec): {name: {key: s[key] for key in KEPT} for name, s in clothes.items()}
        for spec, clothes in worn["detectors"].items()
    }


def over_detectors(rates: dict[str, dict], how: str) -> dict[str, dict]:
    """Reduce each clothes' rates over the detectors, by a numpy function's name; null where a detector has none."""
    names = next(iter(rates.values()))
    values = {name: {rate: [by_name[name][rate] for by_name in rates.values()] for rate in RATES} for name in names}
    return {
        name: {rate: None if None in one else round(float(getattr(np, how)(one)), 4) for rate, one in by_rate.items()}
        for name, by_rate in values.items()
    }


def fold_of(path: Path) -> dict:
    """Read one fold."""
    worn = read_json(path)
    rates = rates_of(worn)
    widths = {
        without_folders(color): curve
        | {"detectors": {without_folders(spec): by_width for spec, by_width in curve["detectors"].items()}}
        for color, curve in worn.get("widths", {}).items()
    }
    counts = {key: worn[key] for key in ("people", "photographs")}
    means, worst = over_detectors(rates, "mean"), over_detectors(rates, "min")
    return counts | {"means": means, "worst": worst, "detectors": rates, "widths": widths}


def main() -> None:
    """Merge the folds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folds", nargs="+", metavar="NAME=WEAR.json")
    parser.add_argument("--about", required=True)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    folds = {name: fold_of(Path(path)) for name, _, path in (fold.partition("=") for fold in given.folds)}
    write_json(given.out, {"about": given.about} | folds)
    for name, fold in folds.items():
        for clothes, mean in fold["means"].items():
            print(f"{name}  {clothes:40}  mean {mean}  worst {fold['worst'][clothes]}")


if __name__ == "__main__":
    main()
