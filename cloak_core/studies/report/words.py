"""Format numbers and names for reports and tables."""

from __future__ import annotations

import html
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import PureWindowsPath

from cloak_core.detectors.defended.table import split_defence
from cloak_core.files.specs import split_spec


def markdown(text: str) -> str:
    """Escape text for a Markdown page: no HTML, no link and no further column comes out of a name."""
    return re.sub(r"([\\`\[\]|])", r"\\\1", html.escape(text, quote=False).replace("&gt;", ">"))


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


def instead(rates: dict) -> str:
    """Say, as the end of a sentence, what is reported in hidden people's places; "" where the detector does not tell.

    rates: figures of `statistics.outcome_record`.
    """
    share = rates.get("renamed")
    if share is None:
        return ""
    if not share:
        return "; nothing else is reported there"
    names = list(rates.get("named") or {})
    return f"; in {percent(share)} something else is reported there" + (f', mostly "{names[0]}"' if names else "")


def most_named(rates: dict) -> str:
    """List what is reported in hidden people's places, the most frequent first: "dog 12, kite 1"; "" for none."""
    return ", ".join(f"{name} {count}" for name, count in (rates.get("named") or {}).items())


def degrees(angle: float | None) -> str:
    """Format an angle: -10.0 -> "−10°"; nothing for none."""
    return "" if angle is None else f"{angle:g}°".replace("-", "−")


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

    def with_folder(spec: str) -> str:
        file = PureWindowsPath(split_spec(spec)[-1].partition("@")[0])
        return f"{short_name(spec)} ({file.parent.name or file.stem})"

    for longer in (with_folder, str):
        count = Counter(names.values())
        names = {spec: name if count[name] == 1 else longer(spec) for spec, name in names.items()}
    return names


def file_name(spec: str) -> str:
    """Make a detector's name part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", short_name(spec).lower()).strip("-")


def duration(seconds: float | int) -> str:
    """Format seconds: 75.2 -> "1 min 15 s"."""
    whole = round(seconds)
    if whole < 60:
        return f"{seconds:.1f} s"
    hours, rest = divmod(whole, 3600)
    return (f"{hours} h " if hours else "") + f"{rest // 60} min" + ("" if hours else f" {rest % 60} s")


def plain(value: object) -> str:
    """Write a value of a record: numbers short, lists with commas, "not set" for none."""
    if value is None:
        return "not set"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(plain(v) for v in value)
    return str(value)
