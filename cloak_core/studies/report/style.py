"""Set the style of every plot: colours safe for colour-blind eyes and in grey, one font, one set of sizes."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure
from matplotlib.textpath import TextPath

from cloak_core.files.writing import replace_file

# Colours by Okabe and Ito (2008), ordered so that their greys differ too; marker and dash tell series apart in grey.
SERIES = {
    "logo": {"label": "trained colours", "color": "#0072b2", "marker": "o", "ls": "-"},
    "clothing": {"label": "own clothing", "color": "#d55e00", "marker": "s", "ls": "--"},
    "grey": {"label": "grey", "color": "#7a7a7a", "marker": "D", "ls": ":"},
    "random": {"label": "random colours", "color": "#cc79a7", "marker": "^", "ls": "-."},
    "stripes": {"label": "stripes", "color": "#009e73", "marker": "v", "ls": (0, (5, 1, 1, 1, 1, 1))},
    "checks": {"label": "checks", "color": "#b8860b", "marker": "P", "ls": (0, (1, 1))},
}
"""How the logo and its controls are drawn, as matplotlib takes it."""
CYCLE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a7a7a")
_COLORS = dict.fromkeys([*(series["color"] for series in SERIES.values()), *CYCLE])
MARKERS = "osD^vPX"
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)))
INK, FAINT = "#1f2328", "#d5d9de"
CSS_COLORS = {INK: "--ink", FAINT: "--faint"} | {color: f"--c{i}" for i, color in enumerate(_COLORS)}
"""The CSS variables that stand for the colours on pages."""
TITLES = 80
"""Letters of the titles of panels beside each other, in one line over all of them."""
WIDTH = 6.4
"""Of a full-width figure, inches."""
LEGEND = 8
"""Size of a legend's text, points."""

_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": LEGEND,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "lines.markersize": 4.5,
    "figure.dpi": 100,
    "savefig.dpi": 200,
    "svg.hashsalt": "cloak",
}


@contextmanager
def style(**changes: object) -> Iterator[None]:
    """Give figures made inside the project's style, whatever the caller's matplotlib is set to."""
    with matplotlib.rc_context({**matplotlib.rcParamsDefault, "backend": "agg", **_STYLE, **changes}):
        yield


def new_figure(width: float = WIDTH, height: float = 2.9, columns: int = 1, **axes: object) -> tuple[Figure, list]:
    """Make a figure of this size in inches and its axes, in one row. Call it inside `style`."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, list(figure.subplots(1, columns, squeeze=False, **axes)[0])


def look_of(k: int, value: object = None) -> dict:
    """Look up colour, marker, dash and label of the logo or a control, or of the k-th of other series."""
    return SERIES.get(value) or {"color": CYCLE[k % 7], "marker": MARKERS[k % 7], "ls": DASHES[k % 7]}


def percent_axis(axis: object, label: str = "attack success") -> None:
    """Set up rates along y, from 0 to 100 %."""
    axis.set_ylim(-0.03, 1.03)
    axis.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0 %", "25 %", "50 %", "75 %", "100 %"])
    axis.set_ylabel(label)


def panel_title(axis: object, name: str, panels: int = 1) -> None:
    """Name one of several panels beside each other; the more panels, the smaller the text."""
    if panels > 1:
        lines = textwrap.wrap(name, TITLES // panels, break_long_words=False, break_on_hyphens=False)
        axis.set_title("\n".join(lines), fontsize=8 if panels == 2 else 7)
    else:
        axis.set_title(name)


def legend_above(figure: Figure) -> None:
    """Draw one legend above the figure's axes, in as many columns as its width holds; none without labels."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    if not labels:
        return
    texts = [TextPath((0, 0), label, size=LEGEND).get_extents().width for label in labels]  # points
    widths = [text / 72 + 0.62 for text in texts]  # inches, with handle and space
    room = figure.get_figwidth() - 0.1
    columns = len(labels) if sum(widths) <= room else max(1, int(room / max(widths)))
    figure.set_figheight(figure.get_figheight() + 0.17 * (-(-len(labels) // columns) - 1))  # not at the axes' cost
    figure.legend(handles, labels, loc="outside upper left", ncols=columns, handlelength=2.6, columnspacing=1.6)


def save_figure(figure: Figure, path: Path) -> list[Path]:
    """Write PATH.png and PATH.svg, white behind, the same bytes for the same figure."""
    written = []
    for suffix, metadata in (("png", {"Software": None}), ("svg", {"Date": None})):
        target = path.with_name(f"{path.name}.{suffix}")
        draw = partial(figure.savefig, format=suffix, metadata=metadata, facecolor="white")
        replace_file(target, draw)
        written.append(target)
    return written
