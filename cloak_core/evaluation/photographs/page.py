"""The report on photographs: one HTML file that opens offline, in the look of the run's report."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from cloak_core.evaluation.figures import SERIES, legend_above, new_figure, percent_axis, style
from cloak_core.evaluation.photographs.counting import make_sample
from cloak_core.evaluation.photographs.listing import NOBODY, WITH, WITHOUT
from cloak_core.evaluation.photographs.looking import Looks
from cloak_core.evaluation.report import page as report
from cloak_core.evaluation.report.words import interval, percent, short_name
from cloak_core.files.reading import MAX_TEXT_BYTES, read_text
from cloak_core.files.writing import write_text

HERE = Path(__file__).parent
PAIRS, WORST = 8, 6
LABELS = {WITH: "with the cloak", WITHOUT: "without"}


def write_page(path: Path, name: str, summary: dict, looks: Looks) -> Path:
    """Write the report and return its path."""
    with style(**{"svg.fonttype": "none"}):
        detectors = [_detector(summary, looks, d) for d in range(len(looks.specs))]
    page = {
        "name": name,
        "css": Markup(read_text(report.HERE / "style.css", MAX_TEXT_BYTES)),
        "summary": summary,
        "lede": lede(summary),
        "detectors": detectors,
        "pairs": [[_shot(looks, i) for i in pair] for pair in shown_pairs(looks)],
        "settings": [(key.replace("_", " "), f"{value:g}") for key, value in summary["settings"].items()],
    }
    write_text(path, report.environment(HERE).get_template("judge.html").render(page))
    return path


def lede(summary: dict) -> str:
    """The first detector's result in a sentence."""
    spec, told = next(iter(summary["detectors"].items()))
    cloaked, clean, name = told[WITH], told[WITHOUT], short_name(spec)
    found = f"Without the cloak {name} finds {percent(clean['detected'])} of {clean['n_all']} people in the pictures"
    if cloaked["conditional"] is None:
        hidden = f"with it {percent(cloaked['detected'])} of {cloaked['n_all']}; no clean picture to compare with"
        return f"{found}, {hidden}."
    return (
        f"Where {name} finds a person without the cloak, it misses the same person in the cloak in "
        f"{percent(cloaked['conditional'])} of {cloaked['n_conditional']} pictures (95 % interval "
        f"{interval(cloaked['ci95_conditional'])}). {found}, with it {percent(cloaked['detected'])} of "
        f"{cloaked['n_all']}."
    )


def shown_pairs(looks: Looks) -> list[tuple[int, int]]:
    """(without, with): the first pair of each person and scene, at most eight of these, evenly spaced; nobody has
    looked at a score."""
    sample, first = make_sample(looks.subjects), {}
    for i, one in enumerate(looks.subjects):
        if one.garment == WITH and len(sample.partners[i]):
            first.setdefault((one.person, one.place), (int(sample.partners[i][0]), i))
    pairs = list(first.values())
    chosen = np.unique(np.linspace(0, len(pairs) - 1, min(PAIRS, len(pairs))).round().astype(int))
    return [pairs[k] for k in chosen]


def _detector(summary: dict, looks: Looks, d: int) -> dict:
    spec = looks.specs[d]
    told, threshold = summary["detectors"][spec], summary["threshold"]
    rows = [(LABELS[WITH], told[WITH], "--c0"), (LABELS[WITHOUT], told[WITHOUT], "--c1")]
    rows += [(name, rates, f"--c{2 + k % 4}") for k, (name, rates) in enumerate(told["controls"].items())]
    worn = [i for i, one in enumerate(looks.subjects) if one.garment == WITH and looks.score[d, i] > threshold]
    clean = [i for i, one in enumerate(looks.subjects) if one.garment == WITHOUT and looks.score[d, i] <= threshold]
    alarms = [i for i, one in enumerate(looks.subjects) if one.garment == NOBODY and looks.score[d, i] > threshold]
    order = lambda indices, sign: sorted(indices, key=lambda i: (sign * float(looks.score[d, i]), i))[:WORST]
    groups = {
        title: list(told[key].items())
        for title, key in (("person", "by_person"), ("scene", "by_scene"), ("distance (m)", "by_distance"))
        if len(told.get(key, {})) > 1
    }
    return {
        "spec": spec,
        "name": short_name(spec),
        "own": looks.own[d],
        "hash": summary["detector_hashes"][spec],
        "rows": rows,
        "told": told,
        "groups": groups,
        "figure": report.svg(by_distance(told["by_distance"])) if len(told.get("by_distance", {})) > 1 else None,
        "found": [_shot(looks, i) for i in order(worn, -1)],
        "missed": [_shot(looks, i) for i in order(clean, 1)],
        "alarms": [_shot(looks, i) for i in order(alarms, -1)],
    }


def by_distance(groups: dict[str, dict]) -> Figure:
    """Share of people found over the distance, with and without the cloak, with 95 % bands."""
    figure, (axis,) = new_figure()
    for side, look in ((WITH, SERIES["logo"]), (WITHOUT, SERIES["clothing"])):
        rates = [(float(key), told[side]) for key, told in groups.items() if told[side]["detected"] is not None]
        metres, values = [x for x, _ in rates], [told["detected"] for _, told in rates]
        axis.plot(metres, values, color=look.color, marker=look.marker, ls=look.dash, label=LABELS[side], clip_on=False)
        low, high = zip(*(told["ci95_detected"] for _, told in rates), strict=True) if rates else ((), ())
        axis.fill_between(metres, low, high, color=look.color, alpha=0.18, lw=0)
    percent_axis(axis, "found")
    axis.set_xlabel("distance (m)")
    legend_above(figure)
    return figure


def _shot(looks: Looks, i: int) -> dict:
    """A subject's picture with all boxes, and what each detector makes of the subject."""
    one, picture = looks.subjects[i], looks.pictures[looks.picture[i]]
    scale = min(1.0, 480 / max(picture.width, picture.height))
    data = base64.b64encode(picture.thumbnail).decode()
    boxes = [(d, box) for d, spec in enumerate(looks.specs) for box in picture.boxes[spec]]
    words: Sequence[str] = (one.person, one.scene, "" if one.distance is None else f"{one.distance:g} m")
    return {
        "image": f"data:image/jpeg;base64,{data}" if data else "",
        "width": round(picture.width * scale),
        "height": round(picture.height * scale),
        "told": None if one.box is None else _drawn(0, [scale * picture.scale * x for x in one.box], 0.0),
        "boxes": [_drawn(d, [scale * x for x in box[:4]], box[4]) for d, box in boxes],
        "label": " · ".join(filter(None, words)) or one.file,
        "garment": LABELS.get(one.garment, one.garment),
        "file": one.file + (f" frame {picture.frame}" if picture.frame else ""),
        "scores": [(short_name(spec), float(looks.score[d, i])) for d, spec in enumerate(looks.specs)],
    }


def _drawn(d: int, corners: list[float], score: float) -> dict:
    x1, y1, x2, y2 = corners
    return {"d": d, "x": x1, "y": y1, "w": max(x2 - x1, 0), "h": max(y2 - y1, 0), "score": f"{score:.2f}"}
