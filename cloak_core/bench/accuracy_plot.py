"""The accuracy run as a plot: errors against the time of a new view, a column for each scene."""

from __future__ import annotations

from pathlib import Path

_COLORS = {"ours": "tab:red", "embreex": "tab:blue", "mitsuba": "tab:green", "moderngl": "tab:purple"}
_PANELS = {"gradient_smooth": ("gradient error, relative", 0.05), "image_rms": ("image error, RMS", 1 / 255)}
"""Rows of the plot, each with the error that the default setting has to stay below."""
_ACROSS = 4


def plot(result: dict, path: Path) -> None:
    """Plot for each scene the gradient's error above the image's, four scenes side by side."""
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
        pair[0].set(title=name)
        pair[-1].set(xlabel="new view, ms")
        pair[0].sharex(pair[-1])
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(path, dpi=110)


def _draw(panel: object, points: list[dict], error: str, default: str) -> None:
    """Draw a point for each way to build a view; ours are named by their samples."""
    panel.set_visible(True)
    panel.margins(0.12)
    panel.set(xscale="log", yscale="log")
    panel.grid(True, which="major", color="0.92")
    for point in points:
        family, _, samples = point["name"].partition("-")
        place = point["new_view_ms"], point[error]
        is_first = samples == "1"
        size = 90 if point["name"] == default else 22
        panel.scatter(*place, color=_COLORS.get(family, "0.4"), s=size, label=family if is_first else None, zorder=3)
        if family == "ours":
            panel.annotate(samples, place, textcoords="offset points", xytext=(-5, -11), ha="right", fontsize=8)
