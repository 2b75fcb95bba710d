"""Format numbers, names and sentences for reports and tables."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from pathlib import PureWindowsPath

from cloak_core.detectors.defended.table import split_defence
from cloak_core.evaluation.report.history import History
from cloak_core.evaluation.report.style import SERIES
from cloak_core.files.specs import split_spec


def percent(value: float | None) -> str:
    """Format a share: 0.964 -> "96 %"; near 0 and 100 % with one more digit, so that "100 %" means all."""
    if value is None:
        return "–"
    digits = 1 if 0 < value < 0.01 or 0.99 < value < 1 else 0
    shown = f"{100 * value:.{digits}f}"
    if value < 1 and float(shown) == 100:
        return "> 99.9 %"
    return f"{shown} %"


def interval(bounds: list[float | None]) -> str:
    """Format bounds: [0.88, 0.99] -> "88 – 99 %"."""
    low, high = bounds
    return "–" if low is None or high is None else f"{percent(low).removesuffix(' %')} – {percent(high)}"


def degrees(angle: float | None) -> str:
    """Format an angle: -10.0 -> "−10°"; nothing for none."""
    return "" if angle is None else f"{angle:g}°".replace("-", "−")


def control_label(control: str) -> str:
    """Name a control in words."""
    return SERIES[control].label if control in SERIES else control


def short_name(spec: str) -> str:
    """Shorten a detector's spec to its name without folders.

    jpeg=75:darknet:/a/b.cfg:/a/b.weights@224 becomes "jpeg=75 darknet b @224".
    """
    if (defended := split_defence(spec)) is not None:
        return f"{defended[0]} {short_name(defended[1])}"
    family, _, rest = spec.partition(":")
    if not rest:
        return spec
    first = split_spec(rest)[0]
    size = spec.rpartition("@")[2] if "@" in spec.rpartition(":")[2] else ""
    name = first.partition("@")[0]
    name = PureWindowsPath(name).stem if {"/", "\\", "."} & set(first) else name
    return f"{family} {name}" + (f" @{size}" if size else "")


def short_names(specs: Iterable[str]) -> dict[str, str]:
    """Shorten several specs; equal names get the folder of the file, or else the whole spec."""
    names = {spec: short_name(spec) for spec in dict.fromkeys(specs)}
    for told in (_with_folder, str):
        count = Counter(names.values())
        names = {spec: name if count[name] == 1 else told(spec) for spec, name in names.items()}
    return names


def _with_folder(spec: str) -> str:
    file = PureWindowsPath(split_spec(spec)[-1].partition("@")[0])
    return f"{short_name(spec)} ({file.parent.name or file.stem})"


def file_name(spec: str) -> str:
    """Make a detector's name part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", short_name(spec).lower()).strip("-")


def lede(summary: dict) -> str:
    """Say the result of the first detector: at its own threshold, then at the paper's, with interval and control.

    Also says whether the colours were trained against it, and of how many detectors it is the first.
    """
    spec, rates = next(iter(summary["detectors"].items()))
    logo, clothing = rates["logo"], rates["clothing"]
    own, threshold = summary.get("operating_points", {}).get(spec), summary["settings"]["threshold"]
    box = {True: " (white box: trained against it)", False: " (black box: never trained against it)", None: ""}
    bodies, others = len(rates["by_body"]), len(summary["detectors"]) - 1
    shown = f" of {bodies} {'body' if bodies == 1 else 'bodies'}" if bodies else ""
    at_paper = f"in {percent(logo['success'])} above {threshold:g} (95 % interval {interval(logo['ci95'])})"
    if own is None or logo.get("success_own") is None:
        found, missed = at_paper, percent(clothing["success"])
    else:
        bounds = logo.get("ci95_own")
        sure = f" (95 % interval {interval(bounds)})" if bounds else ""
        found = f"in {percent(logo['success_own'])} above {own:g}, where it is usually run{sure}, and {at_paper}"
        missed = f"{percent(clothing['success_own'])} and {percent(clothing['success'])}"
    words = (
        f"With the trained colours, {short_name(spec)}{box[summary.get('white_box', {}).get(spec)]} finds no person "
        f"{found}, of {logo['n']:,} images{shown}. In own clothing it misses the person in {missed} of the same images."
    )
    return words + (f" Below are {others} more detector{'s' * (others > 1)}." if others else "")


def badges(summary: dict) -> list[tuple[str, str]]:
    """List (kind, text) with kind good, bad or unknown: whether bodies and backgrounds are unseen."""
    words = {True: ("good", "unseen {}"), False: ("bad", "{} seen in training"), None: ("unknown", "{}: not known")}
    told = {part: words[summary["unseen"].get(part)] for part in ("bodies", "backgrounds")}
    return [(kind, text.format(part)) for part, (kind, text) in told.items()]


def setting_rows(config: dict) -> list[tuple[str, str]]:
    """List the training settings, name and value."""
    settings = config.get("settings")
    return [(str(k).replace("_", " "), _value(v)) for k, v in settings.items()] if isinstance(settings, dict) else []


def fact_rows(config: dict, history: History) -> list[tuple[str, str]]:
    """List what was trained, on what, how long, with which versions."""
    parts = (config.get(key) for key in ("scene", "logo", "environment", "backgrounds"))
    scene, logo, environment, backgrounds = (part if isinstance(part, dict) else {} for part in parts)
    number = lambda value, words: words.format(value) if isinstance(value, int) else ""
    poses = scene["poses"] if isinstance(scene.get("poses"), list) else None
    bodies = "" if poses is None else f"{len(poses)} {'body' if len(poses) == 1 else 'bodies'}"
    rows = [
        ("steps", f"{history.step:,}" if history.step else "none"),
        ("training time", duration(history.seconds) if history.seconds else ""),
        ("ended", history.outcome),
        ("scene", _join(scene.get("name"), bodies)),
        ("logo", _join(number(logo.get("faces"), "{:,} faces"), number(scene.get("faces"), "of {:,}"))),
        ("backgrounds", number(backgrounds.get("count"), "{:,} images")),
        ("colours", _colors(config)),
        ("topology", str(config.get("topology", ""))),
        ("cloak", str(config.get("cloak", ""))),
    ]
    rows += [(str(key), _value(value)) for key, value in environment.items()]
    detectors = config.get("detectors")
    for detector in detectors if isinstance(detectors, list) else []:
        if isinstance(detector, dict):
            rows.append(("trained against", f"{detector.get('spec', '')} (SHA-256 {detector.get('sha256', '')})"))
    return [(name, value) for name, value in rows if value]


def _colors(config: dict) -> str:
    """Say which colours are allowed: "at most 8 distinct, learnt; patches of at least 2 cm"."""
    settings, palette, words = config.get("settings"), config.get("palette"), []
    settings = settings if isinstance(settings, dict) else {}
    if settings.get("colors_at_most"):
        source = f"of a palette of {palette.get('colors')}" if isinstance(palette, dict) else "learnt"
        words.append(f"at most {settings['colors_at_most']} distinct, {source}")
    if settings.get("pattern") == "camouflage":
        words.append(f"patches of at least {_value(settings.get('feature_cm'))} cm")
    if config.get("profile"):
        words.append("as they are printed and photographed")
    return "; ".join(words)


def measured_rows(summary: dict) -> list[tuple[str, str]]:
    """List how the evaluation was made."""
    settings, inputs = summary["settings"], summary["inputs"]
    rows = [
        ("images", f"{summary['n']} under each pattern"),
        ("bodies", ", ".join(inputs.get("bodies", []))),
        ("angles", ", ".join(degrees(a) for a in settings.get("angles", []))),
        ("distances", ", ".join(f"{d:g} m" for d in settings.get("distances", []))),
        ("backgrounds", f"{inputs['backgrounds']} to draw from" if "backgrounds" in inputs else ""),
    ]
    rows = [(name, value) for name, value in rows if value]
    shown = {"distances", "angles", "controls"}
    return rows + [(key.replace("_", " "), _value(value)) for key, value in settings.items() if key not in shown]


def duration(seconds: float | int) -> str:
    """Format seconds: 75.2 -> "1 min 15 s"."""
    whole = round(seconds)
    if whole < 60:
        return f"{seconds:.1f} s"
    hours, rest = divmod(whole, 3600)
    return (f"{hours} h " if hours else "") + f"{rest // 60} min" + ("" if hours else f" {rest % 60} s")


def _value(value: object) -> str:
    if value is None:
        return "not set"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(_value(v) for v in value)
    return str(value)


def _join(*parts: object) -> str:
    return " · ".join(str(p) for p in parts if p)
