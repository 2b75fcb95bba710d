"""A card as one HTML page that opens offline, and several side by side; from card.json and the pictures beside it.

The pictures show the worst of what an assessment saw, chosen by rule.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from cloak_core.core.detector import THRESHOLD
from cloak_core.core.evaluation import CLOTHING, LOGO
from cloak_core.core.evaluation.results import NOBODY, Results
from cloak_core.core.evaluation.statistics import undetected
from cloak_core.core.pattern import Pattern
from cloak_core.files.errors import InputError
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_text, written
from cloak_core.studies.card import words
from cloak_core.studies.card.protocol import VERSION, Part, part_of_area
from cloak_core.studies.card.words import name_of, others_strongest, shown, strongest
from cloak_core.studies.imagery import flat_views
from cloak_core.studies.report import page
from cloak_core.studies.report.charts import Bars, Lines, Rings, Rows, rated
from cloak_core.studies.report.pictures import Drawing, describe, first_by, write_flat, write_shot
from cloak_core.studies.report.style import SERIES, WIDTH
from cloak_core.studies.report.words import interval, markdown, percent
from cloak_core.studies.store import RunStore

CARD = "card.html"
PAGES = (CARD, "card.md", "model_card.md")
FLAT = 320
"""Largest side of a cloak's picture, pixels."""
SHOWN = 4
"""Pictures of a kind."""
SIDES = ("front", "back")


def read_card(path: Path) -> dict:
    """Read a card.json. InputError: it is something else, or of another version."""
    card = read_json(path)
    if not str(card.get("format", "")).startswith("cloak card"):
        raise InputError(f"{path}: format is {card.get('format')!r}, not a cloak card")
    if card.get("protocol") != VERSION:
        raise InputError(f"{path}: protocol is {card.get('protocol')!r}; this version has {VERSION!r}")
    return card


def write_card(folder: Path) -> Path:
    """Write card.html, card.md (a leaderboard's line) and model_card.md (for model hubs) from what FOLDER holds.

    FOLDER holds card.json and, where there are pictures, pictures.json.
    """
    card = read_card(folder / "card.json")
    pictures = {"missed": [], "alarms": [], "hidden": {}, "cloaks": []}
    if (folder / "pictures.json").exists():
        pictures |= read_json(folder / "pictures.json")
    write_text(folder / "card.md", "\n".join(markdown_rows([card])) + "\n")
    write_text(folder / "model_card.md", model_card(card))
    rows = (card.get("photographs") or {}).get("rows", {})
    values = {
        "card": card,
        "words": words,
        "worn": sorted(rows.items(), key=lambda pair: -pair[1]["success_own"]),
        "figures": page.figures(card_figures, card),
        "pictures": pictures,
        "hidden": {part: pictures["hidden"][part] for part in _parts_with_pairs(card, pictures["hidden"])},
        "folder": folder / "pictures",
        "place_of": place_of,
        "text": json.dumps({key: card[key] for key in ("counts", "materials", "made")}, indent=2),
    }
    return page.write_page(folder / CARD, "card.html", values)


def write_comparison(folders: Mapping[str, Path], path: Path) -> Path:
    """Write one page that compares the cards in these folders, named by their keys; it links to each one's own page."""
    cards = [read_card(folder / "card.json") | {"label": name} for name, folder in folders.items()]
    links = [Path(os.path.relpath(folder / CARD, path.parent)).as_posix() for folder in folders.values()]
    heads, rows = leaderboard_table(cards)
    values = {
        "title": "Robustness cards",
        "words": words,
        "cards": list(zip(cards, links, strict=True)),
        "heads": heads,
        "rows": rows,
        "figures": page.figures(comparison_figures, cards),
        "mixed": len({(card["size"], card["made"]["seed"]) for card in cards}) > 1,
    }
    return page.write_page(path, "compare.html", values)


def model_card(card: dict) -> str:
    """Write the card as a model hub reads it: YAML front matter (`model-index`) and the sentences below it."""
    clean, name = card["clean"], words.name_of(card)
    figures = [("recall", clean["recall_own"], words.MEASURED), ("ap50", clean["ap50"], words.MEASURED)]
    attacked = [(f"hidden at {row['asked']:.0%} of the body", row) for row in card["white_box"]]
    attacked += [(f"hidden in photographs, {worn}", row) for worn, row in words.worn_rows(card).items()]
    figures += [(label, row["success_own"], row["state"]) for label, row in attacked]
    metrics = [{"type": what, "name": what, "value": value, "args": {"state": sure}} for what, value, sure in figures]
    dataset = {"name": f"Cloak protocol {card['protocol']}, {card['size']}", "type": "cloak"}
    result = {"task": {"type": "object-detection"}, "dataset": dataset, "metrics": metrics}
    index = [{"name": name, "results": [result]}]
    front = {"pipeline_tag": "object-detection", "tags": ["person-detection", "robustness"], "model-index": index}
    keys = [f"{key}: {json.dumps(value)}" for key, value in front.items()]  # JSON is YAML, too
    head, table = "\n".join(["---", *keys, "---"]), "\n".join(markdown_rows([card]))
    _, _, advice = words.judge(card)
    paragraphs = [markdown(text) for text in (words.headline(card), words.lede(card), advice)]
    untested = "\n".join(f"- {markdown(line)}" for line in words.not_tested(card))
    return "\n\n".join([head, f"# {markdown(name)}", table, *paragraphs, "Not tested:", untested]) + "\n"


def _parts_with_pairs(card: dict, hidden: Mapping[str, Sequence]) -> list[str]:
    """Choose the parts whose hidden bodies are shown: the smallest cloak that hides anybody, else the zoo's first one;
    and the circle. `hidden` has what is hidden in each part."""
    areas = [part_of_area(row["asked"]) for row in card["white_box"]]
    zoo = [f"zoo {row['name']}" for row in card["black_box"]["zoo"]]
    smallest = next((part for part in (*areas, *zoo) if hidden.get(part)), "circle")
    return [part for part in dict.fromkeys((smallest, "circle")) if hidden.get(part)]


# --- its line in a leaderboard: a figure is computed in `figures`, and shown as a column here


def leaderboard_row(card: dict) -> dict[str, str]:
    """The card's line in a leaderboard, column by column; photographs first."""

    def both(row: dict | None, key: str = "success_own") -> str:
        # A share and, in a line of its own, its interval: a table of ten columns then fits a page.
        return f"{shown(row, key)}\n({interval(row['ci95_own'])})" if row else shown(row)

    clean, worn = card["clean"], strongest(card, True)
    return {
        "detector": name_of(card),
        "photographs ↓": both(worn),
        **{f"{percent(row['asked'])} ↓": both(row) for row in reversed(card["white_box"])},
        "all around ↓": both(card.get("around")),
        "others' cloaks ↓": both(others_strongest(card["black_box"]["zoo"])),
        "clean recall ↑": both(clean, "recall_own"),
        "AP50 ↑": f"{100 * clean['ap50']:.1f}",
        "false alarms ↓": percent(clean["false_alarms_own"]),
        "threshold": f"{card['operating_point']:g}",
        "size": card["size"],
    }


def leaderboard_table(cards: list[dict]) -> tuple[list[str], list[list[str]]]:
    """The heads and the cells of all cards' lines; a card without a column has "–" there."""
    rows = [leaderboard_row(card) for card in cards]
    heads = list(dict.fromkeys([*max(rows, key=len), *(key for row in rows for key in row)]))
    return heads, [[row.get(head, "–") for head in heads] for row in rows]


def markdown_rows(cards: list[dict]) -> list[str]:
    """Make a Markdown table of cards, one line each."""
    heads, rows = leaderboard_table(cards)
    lines = [heads, ["---"] * len(heads), *rows]
    return ["| " + " | ".join(markdown(cell).replace("\n", "<br>") for cell in line) + " |" for line in lines]


# --- its plots, drawn inside `style.style`

RECALL_WAYS = {"distance": "distance (m)", "azimuth": "azimuth (degrees)", "elevation": "elevation (degrees)"}
MOST_BARS = 20
"""Bodies and poses that are named."""
HIDDEN, FOUND = "people hidden", "found in own clothing"
WIDE = (1.5 * WIDTH, 3.2)
BARS = Bars(y="name", rate=HIDDEN)


def card_figures(card: dict) -> dict[str, Figure | None]:
    """Draw one card, by the names that its page knows: people found, and people hidden; what it has figures for."""
    figures = {"recall": recall([card])}
    for way in ("body", "pose"):
        worst = sorted(card["recall_by"][way].items(), key=lambda pair: pair[1]["recall_own"])[:MOST_BARS]
        figures[f"by_{way}"] = Bars(y="name", rate=FOUND).draw(_own_rows("name", worst, "recall"))
    called = {name: series["label"] for name, series in SERIES.items()} | {"noise": "black and white"}
    controls = [(called.get(name, name), row) for name, row in card["controls"].items()]
    figures["controls"] = BARS.draw(_own_rows("name", controls))
    if zoo := card["black_box"]["zoo"]:
        against = [(row["name"] + " (made against it)" * bool(row["trained_against_it"]), row) for row in zoo]
        figures["zoo"] = BARS.draw(_own_rows("name", against))
    if card["white_box"]:
        # Both thresholds, and what the same faces do untrained.
        beside = {"success_06": f"cloak, at {THRESHOLD:g}"}
        beside |= {f"{control}_own": SERIES[control]["label"] for control in ("random", CLOTHING)}
        by_area = _area_rows(card, f"cloak, at the detector's own {card['operating_point']:g}")
        figures["area"] = Lines(x="area_share", series="name", beside=beside, rate=HIDDEN).draw(by_area)
        by_threshold = [
            {"cloak": f"{100 * row['area']:.0f} % of the body, mean {100 * row['masr']:.0f} %"}
            | {"threshold": float(t), "success": value}
            for row in card["white_box"]
            for t, value in row["by_threshold"].items()
        ]
        figures["threshold"] = Lines(x="threshold", series="cloak", rate=HIDDEN).draw(by_threshold)
    if card.get("around"):
        by_angle = _own_rows("angle", [(float(angle), row) for angle, row in card["around"]["by_angle"].items()])
        label = {"cloak": "cloak for the full circle"}
        figures["around"] = Rings(series="cloak").draw([label | row for row in by_angle])
    return figures


def comparison_figures(cards: Sequence[dict]) -> dict[str, Figure | None]:
    """Draw what compares cards, by title: people hidden over the cloak's area, each at its own threshold; recall."""
    rows = [row for card in cards for row in _area_rows(card, name_of(card))]
    area = "People hidden against the cloak's area, at each one's own threshold"
    by_area = Lines(x="area_share", series="name", rate=HIDDEN, size=WIDE).draw(rows)
    return ({area: by_area} if rows else {}) | {"Found in own clothing": recall(cards)}


def recall(cards: Sequence[dict]) -> Figure | None:
    """Plot recall in own clothing by distance, azimuth and elevation; a line for each detector."""
    rows = [
        {"name": name_of(card), "way": label, **row}
        for way, label in RECALL_WAYS.items()
        for card in cards
        for row in _own_rows("", ((float(value), row) for value, row in card["recall_by"][way].items()), "recall")
    ]
    return Lines(x="", series="name", panel="way", rate=FOUND, size=WIDE).draw(rows)


def _own_rows(column: str, records: Iterable[tuple[object, dict]], name: str = "success") -> Rows:
    """Make rows of labelled records: the rate at the detector's own threshold, with its interval."""
    return [{column: label, **rated(record, f"{name}_own", "ci95_own")} for label, record in records]


def _area_rows(card: dict, name: str) -> Rows:
    """Make a row for each area of a card's white box: success at the detector's own threshold, and at 0.6."""
    return [
        {**row, "name": name, "area_share": row["area"], "success_06": row["success"]}
        | rated(row, "success_own", "ci95_own")
        for row in card["white_box"]
    ]


# --- the pictures beside a card


def keep_pictures(folder: Path, store: RunStore, seen: Sequence[tuple[Part, Pattern, Results]], card: dict) -> dict:
    """Write pictures into `folder` (replacing what is there) and return what they show, ready for JSON.

    seen: parts, with what was worn in the first repetition and its rows.

    `missed`: own clothing, the lowest scores not above the detector's own threshold; `hidden`: by part of the attack,
    where the page shows it, cloaked bodies that it does not report though it is surest of them in own clothing;
    `alarms`: bare scenes with the surest false alarms; `cloaks`: the cloaks themselves, from the front and from behind.
    """
    shutil.rmtree(folder, ignore_errors=True)
    with written(folder):
        folder.mkdir(parents=True)
    spec, own, detectors = card["spec"], card["operating_point"], store.split.detectors
    pictures: dict = {"missed": [], "alarms": [], "hidden": {}, "cloaks": []}
    trials = {part.name: _hidden_trials(results.rows(spec, LOGO), own) for part, _, results in seen}
    paired = _parts_with_pairs(card, trials)
    for part, pattern, results in seen:
        place = folder / place_of(part.name)
        place.mkdir()
        images, patterns = store.shown(pattern, part.angles, store.evaluate_settings(**part.settings))
        drawing = Drawing(place, images, patterns, detectors)
        if part.name == "clean":
            rows, bare = results.rows(spec, CLOTHING), results.rows(spec, NOBODY)
            for trial in first_by(rows[undetected(rows, own)], SHOWN, ascending=True)["image"].tolist():
                pictures["missed"].append(describe(images, trial) | drawing.shots(trial, (CLOTHING,)))
            for index in first_by(bare[~undetected(bare, own)], SHOWN, ("score", "background"))["background"].tolist():
                shot = write_shot(place / f"bare-{index:05d}.jpg", images.bare([index]), detectors)
                pictures["alarms"].append({"background": images.background_names[index], "bare": shot})
            continue
        if part.name in paired:
            pictures["hidden"][part.name] = [drawing.pair(trial) for trial in trials[part.name]]
        flat = flat_views(store.split.unseen, pattern, FLAT)
        sides = {side: write_flat(place, side, rgba) for side, rgba in flat.items() if side in SIDES}
        pictures["cloaks"].append({"part": part.name} | sides)
    return pictures


def _hidden_trials(rows: pd.DataFrame, own: float) -> list[int]:
    """Choose the hidden images whose person is found most surely in own clothing, of different bodies if possible."""
    gone = rows[undetected(rows, own) & (rows["clean"] > own).to_numpy()]
    gone = gone.sort_values("clean", ascending=False, kind="stable")
    repeated = gone["pose"].duplicated()
    return [*gone["image"][~repeated], *gone["image"][repeated]][:SHOWN]


def place_of(part: str) -> str:
    """Name the folder of a part's pictures, one level below the card's own whatever the part is called."""
    return re.sub(r"[/\\ ]", "-", part).replace("%", "").lstrip(".")
