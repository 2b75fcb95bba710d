"""Measure how many people pictures hide as cloth of several widths.

    python tools/measure_widths.py PICTURE ... --people PEOPLE.json --detector SPEC ... --out DIR

PICTURE is one of those that `cloak wear PICTURE@tile=auto` takes. DIR/widths.json has for each, by its name, what that
command records of the width's choice, and the mean over the detectors at each width. What is in DIR/widths.json
already is not measured again, so that a stopped call goes on.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.detectors.loading import load_detector
from cloak_core.files.reading import read_json
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import write_json
from cloak_core.library.values import cast_of
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.studies.opening import open_pattern
from cloak_core.studies.wearing.wearing import AUTO, WIDTHS, width_curve

RATES = ("success", "success_own")


def measured(picture: str, people: object, detectors: dict) -> dict:
    """Judge a picture at every width; specs without folders, and means over the detectors beside them."""
    curve = width_curve(picture + AUTO, people, detectors, load_backgrounds("procedural:test"), WearSettings())
    rates = {without_folders(spec): by_width for spec, by_width in curve["detectors"].items()}
    mean = {
        f"{metres:g}": {
            rate: round(float(np.mean([by_width[f"{metres:g}"][rate] for by_width in rates.values()])), 4)
            for rate in RATES
        }
        for metres in WIDTHS
    }
    return curve | {"detectors": rates, "mean": mean}


def main() -> None:
    """Measure every picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pictures", nargs="+")
    parser.add_argument("--people", required=True)
    parser.add_argument("--detector", action="append", required=True)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    detectors, people = {spec: load_detector(spec) for spec in given.detector}, cast_of(given.people)
    given.out.mkdir(parents=True, exist_ok=True)
    kept = given.out / "widths.json"
    record = read_json(kept) if kept.exists() else {}
    for picture in given.pictures:
        name = open_pattern(f"{picture}@tile=0.5")[2].removesuffix("@tile=0.5")
        if name not in record:
            record[name] = measured(picture, people, detectors)
            write_json(kept, record)
        print(name, record[name]["chosen"], record[name]["mean"][f"{record[name]['chosen']:g}"], flush=True)


if __name__ == "__main__":
    main()
