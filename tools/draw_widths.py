"""Measure how many people pictures hide as cloth of several widths, and draw the curves.

    python tools/draw_widths.py PICTURE ... --people PEOPLE.json --detector SPEC ... --out DIR

PICTURE is one of those that `cloak wear PICTURE@tile=auto` takes. DIR/widths.json has for each, by its name, what that
command records of the width's choice, and the mean over the detectors at each width; DIR/widths.png draws it. What is
in DIR/widths.json already is not measured again, so that a stopped call goes on.

    python tools/draw_widths.py --draw WIDTHS.json PICTURE.png

draws such a file again.
"""

from __future__ import annotations

import argparse
import sys
from itertools import cycle
from pathlib import Path

import numpy as np

from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.detectors.loading import load_detector
from cloak_core.files.reading import read_json
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import write_json
from cloak_core.library import load_people
from cloak_core.sources.backdrops.backgrounds import load_backgrounds
from cloak_core.studies.opening import open_pattern
from cloak_core.studies.report.style import CYCLE, MARKERS, WIDTH, new_figure, percent_axis, style
from cloak_core.studies.wearing.widths import AUTO, WIDTHS, width_curve

PRINT = "print:"
RATES = {"success": "at 0.6", "success_own": "at the own thresholds"}


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


def draw(record: dict, path: Path) -> None:
    """Draw the mean success of every picture against its width, a panel for each threshold; plain prints are dashed."""
    plain = [name for name in record if name.startswith(PRINT)]
    pictures = [name for name in record if name not in plain]
    with style():
        figure, axes = new_figure(1.5 * WIDTH, 0.7 * WIDTH, columns=len(RATES))
        for axis, (rate, label) in zip(axes, RATES.items(), strict=True):
            for names, line in ((pictures, "-"), (plain, "--")):
                for name, color, marker in zip(names, cycle(CYCLE), cycle(MARKERS), strict=False):
                    points = [(100 * float(metres), one[rate]) for metres, one in record[name]["mean"].items()]
                    look = {"color": color, "marker": marker, "markersize": 3, "linestyle": line}
                    axis.plot(*zip(*points, strict=True), linewidth=1, label=name, **look)
            axis.set_xscale("log")
            ticks = [100 * metres for metres in WIDTHS]
            axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
            axis.set_xticks([], minor=True)
            axis.set_xlabel("width of the cloth, cm")
            percent_axis(axis, f"hidden {label}")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
        figure.savefig(path, dpi=150)


def main() -> None:
    """Measure every picture, then draw."""
    if sys.argv[1:2] == ["--draw"]:
        return draw(read_json(Path(sys.argv[2])), Path(sys.argv[3]))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pictures", nargs="+")
    parser.add_argument("--people", required=True)
    parser.add_argument("--detector", action="append", required=True)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    detectors, people = {spec: load_detector(spec) for spec in given.detector}, load_people(given.people)
    given.out.mkdir(parents=True, exist_ok=True)
    kept = given.out / "widths.json"
    record = read_json(kept) if kept.exists() else {}
    for picture in given.pictures:
        name = open_pattern(f"{picture}@tile=0.5")[2].removesuffix("@tile=0.5")
        if name not in record:
            record[name] = measured(picture, people, detectors)
            write_json(kept, record)
        print(name, record[name]["chosen"], record[name]["mean"][f"{record[name]['chosen']:g}"], flush=True)
    draw(record, given.out / "widths.png")


if __name__ == "__main__":
    main()
