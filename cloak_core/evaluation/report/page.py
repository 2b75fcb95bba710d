"""Builds a run's report: one HTML file that opens offline, with every picture and plot inside and no script at all."""

from __future__ import annotations

import base64
import json
from itertools import groupby
from operator import itemgetter
from pathlib import Path

import jinja2
from markupsafe import Markup
from matplotlib.figure import Figure

from cloak_core.evaluation.evaluation_folder import FOLDER, StoredEvaluation, read_evaluation
from cloak_core.evaluation.figures import inline_svg, style
from cloak_core.evaluation.report import plots, words
from cloak_core.evaluation.report.history import History, read_history
from cloak_core.files.errors import InputError
from cloak_core.files.reading import MAX_TEXT_BYTES, read_bytes, read_json, read_text
from cloak_core.files.writing import write_text

HERE = Path(__file__).parent
BLENDER = "blender.png"
"""What a training through Blender leaves in the run folder: the cloaked body as Blender renders it."""
TURNTABLE = "turntable.gif"
"""What `cloak film RUN --camera orbit --out RUN/turntable.gif` leaves there; it stands for the evaluation's own."""
MAX_PICTURE = 16 << 20
"""Bytes; larger picture files are left out."""


def make_report(run: Path) -> Path:
    """Write RUN/report.html from what the run folder holds and return its path.

    A run without an evaluation gets a report that says so. InputError names a folder that is no run, or a damaged file.
    """
    run = Path(run)
    if not (run / "config.json").exists():
        raise InputError(f"{run}: not a run folder (no config.json in it)")
    config = read_json(run / "config.json")
    history = read_history(run)
    stored = read_evaluation(run / FOLDER) if (run / FOLDER).exists() else None
    with style(**{"svg.fonttype": "none"}):
        page = {
            "name": run.resolve().name,
            "css": Markup(read_text(HERE / "style.css", MAX_TEXT_BYTES)),  # our own file, nothing of the user's
            "config": config,
            "config_text": json.dumps(config, indent=2),
            "settings": words.setting_rows(config),
            "facts": words.fact_rows(config, history),
            "training": _training(history),
            "previews": _previews(run),
            "blender": data_uri(run / BLENDER) if (run / BLENDER).exists() else None,
            "turntable": _turntable(run, stored),
            "evaluation": _evaluation(stored) if stored else None,
        }
    report = run / "report.html"
    write_text(report, environment(HERE).get_template("report.html").render(page))
    return report


def environment(folder: Path) -> jinja2.Environment:
    """Templates of a folder; everything that is put into them is escaped unless this module made it."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([folder, HERE]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "percent": words.percent,
        "interval": words.interval,
        "degrees": words.degrees,
        "label": words.control_label,
    }
    return environment


def _training(history: History) -> Markup | None:
    if not (history.losses or history.success):
        return None
    return svg(plots.training_curves(history.losses, history.success))


def _previews(run: Path) -> list[str]:
    """The first and the last preview, as data."""
    files = sorted((run / "previews").glob("*.png"))
    return [data_uri(file) for file in dict.fromkeys(files[:1] + files[-1:]) if file.stat().st_size <= MAX_PICTURE]


def _turntable(run: Path, stored: StoredEvaluation | None) -> str | None:
    """The run's film from all around, or the evaluation's, as data; evaluations of few images have none."""
    if (run / TURNTABLE).exists():
        return data_uri(run / TURNTABLE)
    if stored is None or "turntable" not in stored.pictures:
        return None
    return data_uri(stored.folder / "pictures" / Path(stored.pictures["turntable"]).name)


def _evaluation(stored: StoredEvaluation) -> dict:
    summary, pictures, folder = stored.summary, stored.pictures, stored.folder / "pictures"
    threshold = summary["settings"]["threshold"]
    detectors = [
        _detector(stored, d, spec, rates, threshold) for d, (spec, rates) in enumerate(summary["detectors"].items())
    ]
    specs = list(summary["detectors"])
    shown = [_pair(folder, specs, shot) for shot in pictures["gallery"]]
    gallery = [(body, list(pairs)) for body, pairs in groupby(shown, key=itemgetter("body"))]
    return {
        "summary": summary,
        "threshold": threshold,
        "detectors": detectors,
        "controls": list(stored.measurement.controls),
        "lede": words.lede(summary),
        "badges": words.badges(summary),
        "gallery": gallery,
        "columns": max([3, *(len(pairs) for _, pairs in gallery)]),  # fewer would be larger than they were rendered
        "strip": _strip(folder, specs, pictures["controls"]),
        "flat": {side: data_uri(folder / Path(name).name) for side, name in pictures["flat"].items()},
        "size": summary["settings"]["size"],
        "measured": words.measured_rows(summary),
    }


def _detector(stored: StoredEvaluation, d: int, spec: str, rates: dict, threshold: float) -> dict:
    measurement, summary = stored.measurement, stored.summary
    folder = stored.folder / "pictures"
    figures = {"Success by angle": svg(plots.success_by_angle(measurement, d, threshold))}
    if len(set(measurement.trials.distance.tolist())) > 1:
        figures["Success by distance"] = svg(plots.success_by_distance(measurement, d, threshold))
    figures["Success by body"] = svg(plots.success_by_body(measurement, d, threshold))
    figures["Success by threshold"] = svg(plots.success_by_threshold(measurement, d, threshold))
    failures = stored.pictures["failures"].get(spec, [])
    worst = stored.pictures.get("worst", {}).get(spec, [])
    return {
        "index": d,
        "spec": spec,
        "own": summary.get("operating_points", {}).get(spec),
        "name": words.short_name(spec),
        "rows": [(c, rates[c], rates["average_precision"][c]) for c in measurement.controls],
        "false_alarms": summary["false_alarms"][spec],
        "bare": measurement.bare.shape[1],
        "figures": figures,
        "failures": [_pair(folder, [spec], shot) for shot in failures],
        "worst": [_pair(folder, [spec], shot) | {"success": shot["success"]} for shot in worst],
        "bodies": len(set(measurement.trials.pose.tolist())),
        "failed": int((measurement.score[d, 0] > threshold).sum()),
        "hash": summary["inputs"]["detector_hashes"][spec],
    }


def _pair(folder: Path, specs: list[str], shot: dict) -> dict:
    label = {key: shot[key] for key in ("body", "angle", "distance", "background")}
    return label | {control: told_shot(folder, specs, shot[control]) for control in ("clothing", "logo")}


def _strip(folder: Path, specs: list[str], shot: dict) -> dict:
    label = {key: shot[key] for key in ("body", "angle", "background")}
    return label | {"images": {c: told_shot(folder, specs, picture) for c, picture in shot["images"].items()}}


def told_shot(folder: Path, specs: list[str], picture: dict) -> dict:
    """One picture with its boxes, and what every detector made of it."""
    boxes = [
        {"d": d, "x": b[0], "y": b[1], "w": max(b[2] - b[0], 0), "h": max(b[3] - b[1], 0), "score": f"{b[4]:.2f}"}
        for d, spec in enumerate(specs)
        for b in picture["boxes"].get(spec, [])
    ]
    found = [(d, bool(picture["boxes"].get(spec)), picture["scores"].get(spec, 0)) for d, spec in enumerate(specs)]
    return {"image": data_uri(folder / Path(picture["file"]).name), "boxes": boxes, "found": found}


def svg(figure: Figure) -> Markup:
    """A figure as markup. Matplotlib escapes the text it draws."""
    return Markup(inline_svg(figure))


def data_uri(path: Path) -> str:
    """A picture file as a data: address. InputError where it is missing or larger than a picture can be."""
    data = read_bytes(path, MAX_PICTURE)
    kind = {".jpg": "jpeg", ".png": "png", ".gif": "gif"}.get(path.suffix, "png")
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
