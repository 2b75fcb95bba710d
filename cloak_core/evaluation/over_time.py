"""Success over time: what a run's colours were worth after so many steps, seconds and queries."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cloak_core.attack.events import read_events
from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation.evaluate import evaluate
from cloak_core.evaluation.experiments.drawing import look
from cloak_core.evaluation.figures import legend_above, new_figure, percent_axis, save_figure, style
from cloak_core.evaluation.inference import OnProgress
from cloak_core.evaluation.report.words import short_name
from cloak_core.evaluation.settings import EvaluateSettings
from cloak_core.exchange.bodies import Bodies
from cloak_core.exchange.colors import read_colors
from cloak_core.files.errors import InputError
from cloak_core.files.writing import write_json
from cloak_core.scene.backdrops.backgrounds import Backgrounds
from cloak_core.scene.logos.logo import Logo

_NAME = re.compile(r"step-(\d{8,})\.npy")
_KEPT = ("success", "success_own", "ci95", "ci95_own", "n")


def over_time(
    run: Path,
    logo: Logo,
    bodies: Bodies,
    backgrounds: Backgrounds,
    detectors: dict[str, Detector],
    angles: Sequence[float],
    settings: EvaluateSettings,
    on_progress: OnProgress | None = None,
) -> list[dict]:
    """Judge every snapshot of a run on the same images; writes RUN/curve.json, .png and .svg.

    A row each: {"step", "seconds", "queries" (of a search), "detectors": {SPEC: {"success", "success_own", "ci95",
    "ci95_own", "n"}}}. InputError: the run kept none (`cloak train --snapshot-every`).
    """
    found = {int(m[1]): path for path in (run / "snapshots").glob("*.npy") if (m := _NAME.fullmatch(path.name))}
    if not found:
        raise InputError(f"{run}: has no snapshots (cloak train --snapshot-every N keeps them)")
    events = read_events(run / "events.jsonl") if (run / "events.jsonl").exists() else []
    told = {event["step"]: event for event in events if event.get("type") == "step"}
    bare = replace(settings, controls=(), bare=1)
    rows = []
    for step, path in sorted(found.items()):
        event = told.get(step, {})
        row = {"step": step, "seconds": event.get("time")} | {k: event[k] for k in ("queries",) if k in event}
        summary = evaluate(
            read_colors(path, len(logo)), logo, bodies, backgrounds, detectors, angles, bare, on_progress=on_progress
        )
        rates = {spec: {key: x["logo"][key] for key in _KEPT} for spec, x in summary["detectors"].items()}
        rows.append(row | {"detectors": rates})
    write_json(run / "curve.json", {"rows": rows})
    with style():
        save_figure(draw(rows), run / "curve")
    return rows


def draw(rows: Sequence[dict]) -> Figure:
    """Success at 0.6 with its intervals over queries, where it was a search, else seconds, else steps."""
    axis_of = {"queries": "queries", "seconds": "training time (s)", "step": "step"}
    along = next(key for key in axis_of if all(row.get(key) is not None for row in rows))
    figure, (axis,) = new_figure()
    x = [row[along] for row in rows]
    for k, spec in enumerate(rows[0]["detectors"]):
        mine = [row["detectors"][spec] for row in rows]
        shape = look(k)
        axis.plot(x, [rate["success"] for rate in mine], label=short_name(spec), clip_on=False, **shape)
        bounds = np.array([rate["ci95"] for rate in mine], float)
        axis.fill_between(x, *bounds.T, color=shape["color"], alpha=0.12, lw=0)
    axis.set_xlabel(axis_of[along])
    percent_axis(axis)
    legend_above(figure)
    return figure
