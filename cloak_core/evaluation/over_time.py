"""Measure success over time: evaluate the snapshots of a run."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cloak_core.attack.events import read_events
from cloak_core.detectors.protocol import Detector
from cloak_core.evaluation.evaluate import evaluate
from cloak_core.evaluation.measure import OnProgress
from cloak_core.evaluation.report.plots import success_over_time
from cloak_core.evaluation.report.style import save_figure, style
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
    """Measure every snapshot of a run on the same images; write RUN/curve.json, .png and .svg.

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
        save_figure(success_over_time(rows, {spec: short_name(spec) for spec in detectors}), run / "curve")
    return rows
