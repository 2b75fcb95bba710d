"""A leave-one-out matrix as a heat map, and as Markdown for documentation: made of the cells alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.report import plots
from cloak_core.evaluation.report.style import SERIES, save_figure, style
from cloak_core.evaluation.report.words import interval, percent, short_name
from cloak_core.evaluation.statistics_card import KINSHIPS, heat_values
from cloak_core.evaluation.transfer.matrix import summary
from cloak_core.evaluation.transfer.plan import CROSS_FAMILY, SAME_FAMILY
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import write_text

MARKS = {SAME_FAMILY: "", CROSS_FAMILY: " *"}
_PLACES = ("angles", "elevation", "distance")
HEADS = ("judged by", "kin", "at 0.6", "95 %", "at its own", "95 %", "at 0.25", "95 %", "random", "own clothing")
HEADS += ("seeds at 0.6", "images", "processor seconds")


def by_ablation(cells: Sequence[dict]) -> dict[str, list[dict]]:
    """Group the cells by their ablation, in order."""
    return {name: [c for c in cells if c["rung"] == name] for name in dict.fromkeys(c["rung"] for c in cells)}


def show(cells: Sequence[dict], folder: Path, name: str, command: str = "") -> list[Path]:
    """Write NAME.png, NAME.svg and NAME.md into the folder: the heat map, and tables for documentation."""
    folder.mkdir(parents=True, exist_ok=True)
    with style():
        files = save_figure(heat_map(cells), folder / name)
    text = [f"# Transfer: {name}", "", caption(cells), "", f"![Heat map]({name}.png)", "", *_tables(cells)]
    text += [f"`{without_folders(command)}`", ""] if command else []
    write_text(folder / f"{name}.md", "\n".join(text))
    return [*files, folder / f"{name}.md"]


def heat_map(cells: Sequence[dict]) -> Figure:
    """Plot success at 0.6 of every ablation by every judged detector, and below it the controls on the same images.

    A single ablation is also shown at the other thresholds. The last column is the mean.
    """
    judged, rows = list(dict.fromkeys(cell["judged"] for cell in cells)), {}
    ladder, last = by_ablation(cells), {cell["judged"]: cell for cell in cells}
    kinds = {"": " at 0.6", "_own": " at its own", "_025": " at 0.25"} if len(ladder) == 1 else {"": ""}
    for ablation, own in ladder.items():
        for suffix, words in kinds.items():
            found = {cell["judged"]: cell[f"success{suffix}"] for cell in own}
            rows[ablation + words] = [found.get(name) for name in judged]
    for control in ("random", CLOTHING):
        rows[SERIES[control].label] = [last[name][control] for name in judged]
    columns = [*(short_name(name) + MARKS[last[name]["kin"]] for name in judged), "mean"]
    figure = plots.heat_map(heat_values(rows), list(rows), columns, rule=len(rows) - 2)
    (axis,) = figure.axes
    axis.axvline(len(columns) - 1.5, color="white", lw=3)
    axis.set_xlabel("judged by (left out of training)")
    return figure


def caption(cells: Sequence[dict]) -> str:
    """Say what was trained on and judged on."""
    cell, split = cells[-1], cells[-1]["materials"]
    bodies, unseen = split["bodies"], split["unseen"]
    if "people" in split:
        seen, kept = split["people"], split["unseen_people"]
        people = f", and on {seen['count']} people in {seen['photographs']} photographs"
        judged = f"{kept['count']} people in {kept['photographs']} other photographs"
    else:
        people = ""
        judged = (
            f"{len(unseen['poses'])} other bodies in {unseen['outfits']} other outfits before "
            f"{split['unseen_backgrounds']['count']} other backgrounds"
        )
    settings = ", ".join(f"{key} {value}" for key, value in cell["settings"].items() if key in _PLACES)
    seeds = max(len(c["by_seed"]) for c in cells)
    return (
        f"{cell['logo']} ({percent(cell['area_share'])} of the area), {cell['steps']} steps of {cell['batch']} images "
        f"({settings}), {seeds} {'seed' if seeds == 1 else 'seeds'}. Trained on {len(bodies['poses'])} bodies in "
        f"{bodies['outfits']} outfits before {split['backgrounds']['count']} backgrounds{people}; "
        f"judged on {judged}, {cell['images']} images a training, by a "
        "detector that was left out of training. * has no sibling among its surrogates."
    )


def _tables(cells: Sequence[dict]) -> list[str]:
    """Markdown: of each ablation, a line per judged detector, and a line per training."""
    lines = []
    for ablation, own in by_ablation(cells).items():
        told = summary(own)
        mean, worst, low = (percent(told[key]) for key in ("mean", "worst", "mean_025"))
        means = {name: told[f"mean_{name}"] for name in KINSHIPS}
        apart = ", ".join(f"{name}s {percent(value)}" for name, value in means.items() if value is not None)
        lines += [f"### {ablation}", "", f"Mean {mean}, worst {worst} at 0.6; mean {low} at 0.25; {apart}.", ""]
        lines += ["| " + " | ".join(HEADS) + " |", "|" + "---|" * len(HEADS)]
        lines += ["| " + " | ".join(_line(cell)) + " |" for cell in own] + [""]
        judged: dict[tuple[str, ...], list[str]] = {}
        for cell in own:
            judged.setdefault(tuple(cell["surrogates"]), []).append(cell["judged"])
        named = lambda specs: ", ".join(map(short_name, specs))
        lines += [f"- {named(judges)}: trained on {named(surrogates)}" for surrogates, judges in judged.items()] + [""]
    return lines


def _line(cell: dict) -> list[str]:
    """The cells of one line of the table, in the order of `HEADS`."""
    rates = {s: (percent(cell[f"success{s}"]), interval(cell[f"ci95{s}"])) for s in ("", "_own", "_025")}
    own, seconds = f"{rates['_own'][0]} ({cell['operating_point']:g})", cell.get("cpu_seconds")
    return [
        short_name(cell["judged"]),
        cell["kin"],
        *rates[""],
        own,
        rates["_own"][1],
        *rates["_025"],
        percent(cell["random"]),
        percent(cell[CLOTHING]),
        " ".join(percent(value) for value in cell["by_seed"]),
        str(cell["n"]),
        # Wall-clock time would count whatever else the machine did.
        "–" if seconds is None else f"{seconds:.0f}",
    ]
