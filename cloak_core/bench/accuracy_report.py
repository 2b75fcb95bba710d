"""The accuracy run as a folder: accuracy.json, and a plot with the Pareto front."""

from __future__ import annotations

from pathlib import Path

from cloak_core.bench.accuracy_scenes import SCENES
from cloak_core.bench.records import with_earlier
from cloak_core.files.writing import write_json

_COLORS = {
    "ours": "tab:red", "embreex": "tab:blue", "mitsuba": "tab:green", "moderngl": "tab:purple", "open3d": "tab:orange"
}  # fmt: skip
_PANELS = {"gradient_smooth": ("gradient error, relative", 0.05), "image_rms": ("image error, RMS", 1 / 255)}
"""Rows of the plot, each with the error that the default setting has to stay below."""
_ACROSS = 4


def write_report(result: dict, folder: Path) -> dict:
    """Write accuracy.json and accuracy.png, and return what they hold.

    Scenes that an accuracy.json of the folder holds and `result` does not are kept. Raises `InputError` where that
    file cannot be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    result = result | {"scenes": with_earlier(folder / "accuracy.json", "scenes", result["scenes"], tuple(SCENES))}
    write_json(folder / "accuracy.json", result)
    plot(result, folder / "accuracy.png")
    return result


def pareto(points: list[dict], error: str = "gradient_smooth") -> list[dict]:
    """Points that no other point beats in both time and error (by more than a fiftieth), fastest first."""
    front: list[dict] = []
    for point in sorted(points, key=lambda p: (p["new_view_ms"], p[error])):
        if not front or point[error] < 0.98 * front[-1][error]:
            front.append(point)
    return front


def plot(result: dict, path: Path) -> None:
    """Plot errors against the time of a new view: for each scene the gradient's above the image's, four scenes side by
    side."""
    from matplotlib.figure import Figure

    names = list(result["scenes"])
    across = min(len(names), _ACROSS)
    down = -(-len(names) // _ACROSS)
    figure = Figure(figsize=(3.3 * across + 1, 6 * down), layout="constrained")
    panels = figure.subplots(len(_PANELS) * down, across, squeeze=False)
    for panel in panels.flat:
        panel.set_visible(False)
    for number, name in enumerate(names):
        begin, column = number // across * len(_PANELS), number % across
        pair = panels[begin : begin + len(_PANELS), column]
        for panel, (error, (label, limit)) in zip(pair, _PANELS.items(), strict=True):
            _draw(panel, result["scenes"][name]["points"], error, result["default"])
            panel.axhline(limit, color="0.6", linestyle=":", linewidth=1, zorder=0, label="limit set for the default")
            panel.set(ylabel=label if column == 0 else "")
            _measure_by_tens(panel)
        pair[0].set(title=name)
        pair[-1].set(xlabel="new view, ms")
        pair[0].sharex(pair[-1])
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(path, dpi=110)


def _measure_by_tens(panel: object) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    panel.set_visible(True)
    panel.margins(0.12)
    panel.set(xscale="log", yscale="log")
    for axis, steps in ((panel.xaxis, (1, 2, 5)), (panel.yaxis, (1, 3))):
        axis.set_major_locator(LogLocator(subs=steps, numticks=8))
        axis.set_major_formatter(lambda value, position: f"{value:g}")
        axis.set_minor_formatter(NullFormatter())
    panel.grid(True, which="major", color="0.92")


def _draw(panel: object, points: list[dict], error: str, default: str) -> None:
    front = pareto(points, error)
    panel.plot(
        [p["new_view_ms"] for p in front], [p[error] for p in front], color="0.75", zorder=0, label="Pareto front"
    )
    for family in dict.fromkeys(p["name"].split("-")[0] for p in points):
        own = [p for p in points if p["name"].split("-")[0] == family]
        place = [p["new_view_ms"] for p in own], [p[error] for p in own]
        sizes = [90 if p["name"] == default else 22 for p in own]
        panel.scatter(
            *place, color=_COLORS.get(family, "0.4"), s=sizes, label=family, zorder=3 if family == "ours" else 2
        )
    for point in points:
        if point["name"].startswith("ours"):
            text = point["name"].removeprefix("ours-") + (" (default)" if point["name"] == default else "")
            where = {"textcoords": "offset points", "xytext": (-5, -11), "ha": "right", "fontsize": 8}
            panel.annotate(text, (point["new_view_ms"], point[error]), **where)
