"""The accuracy run as a folder: accuracy.json, a plot with the Pareto front, and tables in Markdown."""

from __future__ import annotations

from pathlib import Path

from cloak_core.bench.accuracy import COLUMNS
from cloak_core.scene.exchange import write_json


def write_report(result: dict, folder: Path) -> None:
    """Write accuracy.json, accuracy.png and accuracy.md."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "accuracy.json", result)
    (folder / "accuracy.md").write_text(tables(result), encoding="utf-8")
    plot(result, folder / "accuracy.png")


def tables(result: dict) -> str:
    """One table for each scene; the default setting in bold."""
    machine = result["machine"]
    versions = f"torch {machine['torch']}, Python {machine['python']}"
    lines = [
        f"Measured on {machine['device']}, {result['threads']} threads, {versions}; medians of {result['repeats']}."
    ]
    for name, scene in result["scenes"].items():
        lines += ["", f"### {name}: {scene['triangles']:,} triangles, {scene['pixels']:,} pixels", ""]
        lines += [f"Reference: {scene['reference']}.", "", "| | " + " | ".join(COLUMNS.values()) + " |"]
        lines.append("|---" * (len(COLUMNS) + 1) + "|")
        for point in scene["points"]:
            label = f"**{point['name']}**" if point["name"] == result["default"] else point["name"]
            lines.append(f"| {label} | " + " | ".join(f"{point[key]:.3g}" for key in COLUMNS) + " |")
    return "\n".join(lines) + "\n"


def pareto(points: list[dict]) -> list[dict]:
    """Points that no other point beats in both time and error, fastest first."""
    front: list[dict] = []
    for point in sorted(points, key=lambda p: (p["new_view_ms"], p["gradient_smooth"])):
        if not front or point["gradient_smooth"] < front[-1]["gradient_smooth"]:
            front.append(point)
    return front


def plot(result: dict, path: Path) -> None:
    """Error of the smooth colour gradient against the time of a new view, one panel for each scene."""
    from matplotlib.figure import Figure

    names = list(result["scenes"])
    figure = Figure(figsize=(3.4 * len(names), 3.4), layout="constrained")
    for panel, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        points = result["scenes"][name]["points"]
        front = pareto(points)
        panel.plot([p["new_view_ms"] for p in front], [p["gradient_smooth"] for p in front], color="0.8", zorder=0)
        for point in points:
            default = point["name"] == result["default"]
            place = point["new_view_ms"], point["gradient_smooth"]
            panel.scatter(*place, color="tab:red" if default else "tab:blue", s=28)
            panel.annotate(
                point["name"].removeprefix("ours-"), place, textcoords="offset points", xytext=(5, 4), fontsize=8
            )
        panel.set(xscale="log", yscale="log", title=name, xlabel="new view, ms", ylabel="gradient error, relative")
        panel.xaxis.set_minor_formatter(lambda value, position: "")
        panel.grid(True, which="major", color="0.92")
    figure.savefig(path, dpi=150)
