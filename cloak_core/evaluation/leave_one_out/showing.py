"""The matrix as a heat map, and as Markdown for documentation: made of the cells alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cloak_core.evaluation.controls import CLOTHING
from cloak_core.evaluation.figures import SERIES, new_figure, save_figure, style
from cloak_core.evaluation.leave_one_out.matrix import summary
from cloak_core.evaluation.report.words import interval, percent, short_name
from cloak_core.files.specs import without_folders
from cloak_core.files.writing import write_text

MARKS = {"sibling": "", "stranger": " *"}


def by_rung(cells: Sequence[dict]) -> dict[str, list[dict]]:
    """The cells by their rung, in order."""
    return {rung: [c for c in cells if c["rung"] == rung] for rung in dict.fromkeys(c["rung"] for c in cells)}


def heat_map(cells: Sequence[dict]) -> Figure:
    """Success at 0.6 of every rung by every judged detector; of a single rung also at the other thresholds; below, what
    the same images say of random colours and own clothing."""
    judged = list(dict.fromkeys(cell["judged"] for cell in cells))
    ladder, rows = by_rung(cells), {}
    for rung, own in ladder.items():
        kinds = (("", "at 0.6"), ("_own", "at its own"), ("_025", "at 0.25")) if len(ladder) == 1 else (("", ""),)
        for suffix, words in kinds:
            found = {cell["judged"]: cell[f"success{suffix}"] for cell in own}
            rows[f"{rung} {words}".strip()] = [found.get(name) for name in judged]
    last = {cell["judged"]: cell for cell in cells}
    for control in ("random", CLOTHING):
        rows[SERIES[control].label] = [last[name][control] for name in judged]
    return _drawn(rows, [short_name(name) + MARKS[last[name]["kin"]] for name in judged])


def _drawn(rows: dict[str, list], columns: list[str]) -> Figure:
    shown = np.array([[np.nan if x is None else x for x in row] for row in rows.values()], float)
    shown = np.column_stack(
        [shown, [np.mean(row[~np.isnan(row)]) if (~np.isnan(row)).any() else np.nan for row in shown]]
    )
    figure, (axis,) = new_figure(2.4 + 0.62 * shown.shape[1], 1.5 + 0.3 * len(shown))
    axis.imshow(shown, cmap="cividis", vmin=0, vmax=1, aspect="auto")
    axis.grid(visible=False)
    for (i, j), value in np.ndenumerate(shown):
        words = "–" if np.isnan(value) else f"{100 * value:.0f}"
        axis.text(j, i, words, ha="center", va="center", color="black" if value > 0.55 else "white", fontsize=8)
    axis.axhline(len(shown) - 2.5, color="white", lw=3)
    axis.axvline(shown.shape[1] - 1.5, color="white", lw=3)
    axis.set_xticks(range(shown.shape[1]), [*columns, "mean"], rotation=40, ha="right", rotation_mode="anchor")
    axis.set_yticks(range(len(shown)), list(rows))
    axis.set_xlabel("judged by (left out of training)")
    axis.set_title("success in %")
    return figure


def caption(cells: Sequence[dict]) -> str:
    """What was trained on and judged on, in words."""
    cell, materials = cells[-1], cells[-1]["materials"]
    bodies, unseen = materials["bodies"], materials["unseen"]
    settings = ", ".join(f"{key} {value}" for key, value in cell["settings"].items() if key in _PLACES)
    seeds = max(len(c["by_seed"]) for c in cells)
    return (
        f"{cell['logo']} ({percent(cell['area_share'])} of the area), {cell['steps']} steps of {cell['batch']} images "
        f"({settings}), {seeds} {'seed' if seeds == 1 else 'seeds'}. Trained on {len(bodies['poses'])} bodies in "
        f"{bodies['outfits']} outfits before {materials['backgrounds']['count']} backgrounds; judged on "
        f"{len(unseen['poses'])} other bodies in {unseen['outfits']} other outfits before "
        f"{materials['unseen_backgrounds']['count']} other backgrounds, {cell['images']} images a training, by a "
        "detector that was left out of training. * has no sibling among its surrogates."
    )


_PLACES = ("angles", "elevation", "distance")


def tables(cells: Sequence[dict]) -> list[str]:
    """Markdown: of each rung, a line per judged detector."""
    lines = []
    for rung, own in by_rung(cells).items():
        told = summary(own)
        mean, worst, low = (percent(told[key]) for key in ("mean", "worst", "mean_025"))
        apart = ", ".join(
            f"{name}s {percent(told[f'mean_{name}'])}" for name in MARKS if told[f"mean_{name}"] is not None
        )
        lines += [f"### {rung}", "", f"Mean {mean}, worst {worst} at 0.6; mean {low} at 0.25; {apart}.", ""]
        heads = ["judged by", "kin", "at 0.6", "95 %", "at its own", "95 %", "at 0.25", "95 %"]
        heads += ["random", "own clothing", "seeds at 0.6", "images", "processor seconds"]
        lines += ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
        lines += ["| " + " | ".join(_line(cell)) + " |" for cell in own] + [""]
        lines += [*_surrogates(own), ""]
    return lines


def _surrogates(cells: Sequence[dict]) -> list[str]:
    """Of one rung: a line per training, who judged what was trained on whom."""
    judged: dict[tuple[str, ...], list[str]] = {}
    for cell in cells:
        judged.setdefault(tuple(cell["surrogates"]), []).append(cell["judged"])
    return [f"- {_named(judges)}: trained on {_named(trained_on)}" for trained_on, judges in judged.items()]


def _named(specs: Sequence[str]) -> str:
    return ", ".join(map(short_name, specs))


def _line(cell: dict) -> list[str]:
    point, seeds = cell["operating_point"], " ".join(percent(value) for value in cell["by_seed"])
    rates = [w for s in ("", "_own", "_025") for w in (percent(cell[f"success{s}"]), interval(cell[f"ci95{s}"]))]
    rates[2] += f" ({point:g})"
    # The clock on the wall counts whatever else the machine did.
    seconds = "–" if cell.get("cpu_seconds") is None else f"{cell['cpu_seconds']:.0f}"
    controls = [percent(cell["random"]), percent(cell[CLOTHING])]
    return [short_name(cell["judged"]), cell["kin"], *rates, *controls, seeds, str(cell["n"]), seconds]


def show(cells: Sequence[dict], folder: Path, name: str, command: str = "") -> list[Path]:
    """Write NAME.png, NAME.svg and NAME.md into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with style():
        files = save_figure(heat_map(cells), folder / name)
    text = [f"# Transfer: {name}", "", caption(cells), "", f"![Heat map]({name}.png)", "", *tables(cells)]
    text += [f"`{without_folders(command)}`", ""] if command else []
    write_text(folder / f"{name}.md", "\n".join(text))
    return [*files, folder / f"{name}.md"]
