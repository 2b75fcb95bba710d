"""A card as one HTML page that opens offline, and several side by side; from card.json and the pictures beside it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path

from markupsafe import Markup

from cloak_core.evaluation.card import leaderboard, words
from cloak_core.evaluation.card.leaderboard import markdown_rows, read_card, worn_rows
from cloak_core.evaluation.card.pictures import SIDES, place_of
from cloak_core.evaluation.report import page, plots
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_text

CARD = "card.html"


def write_card(folder: Path) -> Path:
    """Write card.html, card.md (a leaderboard's line) and model_card.md (for model hubs) from what FOLDER holds.

    FOLDER holds card.json and, where there are pictures, pictures.json.
    """
    card = read_card(folder / "card.json")
    pictures = read_json(folder / "pictures.json") if (folder / "pictures.json").exists() else {}
    write_text(folder / "card.md", "\n".join(markdown_rows([card])) + "\n")
    write_text(folder / "model_card.md", model_card(card))
    shown = _pictures(card, pictures, folder / "pictures")
    rows = (card.get("photographs") or {}).get("rows", {})
    values = {
        "card": card,
        "words": words,
        "board": leaderboard,
        "picture": next((pairs[0] for pairs in shown["hidden"].values()), None),
        "worn": sorted(rows.items(), key=lambda pair: -pair[1]["success_own"]),
        "figures": _figures(plots.card_figures, card),
        "pictures": shown,
        "size": card["counts"]["size"],
        "text": json.dumps({key: card[key] for key in ("counts", "materials", "made")}, indent=2),
    }
    return page.write_page(folder / CARD, "card.html", values)


def write_comparison(folders: Mapping[str, Path], path: Path) -> Path:
    """Write one page that compares the cards in these folders, named by their keys; it links to each one's own page."""
    cards = [read_card(folder / "card.json") | {"label": name} for name, folder in folders.items()]
    links = [Path(os.path.relpath(folder / CARD, path.parent)).as_posix() for folder in folders.values()]
    heads, rows = leaderboard.leaderboard_table(cards)
    values = {
        "title": "Robustness cards",
        "words": words,
        "cards": list(zip(cards, links, strict=True)),
        "heads": heads,
        "rows": rows,
        "figures": _figures(plots.comparison_figures, cards),
        "mixed": len({(card["budget"], card["made"]["seed"]) for card in cards}) > 1,
    }
    return page.write_page(path, "compare.html", values)


def model_card(card: dict) -> str:
    """Write the card as a model hub reads it: YAML front matter (`model-index`) and the sentences below it."""
    figures = {"recall": card["clean"]["recall_own"], "ap50": card["clean"]["ap50"]}
    figures |= {f"hidden at {row['asked']:.0%} of the body": row["success_own"] for row in card["white_box"]}
    figures |= {f"hidden in photographs, {name}": row["success_own"] for name, row in worn_rows(card).items()}
    dataset = {"name": f"Cloak protocol {card['protocol']}, {card['budget']}", "type": "cloak"}
    metrics = [{"type": name, "name": name, "value": value} for name, value in figures.items()]
    result = {"task": {"type": "object-detection"}, "dataset": dataset, "metrics": metrics}
    index = [{"name": leaderboard.name_of(card), "results": [result]}]
    front = {"pipeline_tag": "object-detection", "tags": ["person-detection", "robustness"], "model-index": index}
    lines = [f"{key}: {json.dumps(value)}" for key, value in front.items()]  # JSON is YAML, too
    said = [words.headline(card), words.lede(card), words.advice(card), "Not tested:"]
    untested = "\n".join(f"- {line}" for line in words.not_tested(card))
    table = "\n".join(markdown_rows([card]))
    head = "\n".join(["---", *lines, "---"])
    return "\n\n".join([head, f"# {leaderboard.name_of(card)}", table, *said, untested]) + "\n"


def _figures(draw: Callable[..., dict], what: object) -> dict[str, Markup]:
    with page.page_style():
        return {name: page.svg(figure) for name, figure in draw(what).items()}


def _pictures(card: dict, pictures: dict, folder: Path) -> dict:
    """Prepare for the template what pictures.json tells, with the pictures as data."""
    shot = lambda part, told: page.shot(folder / place_of(part), [card["spec"]], told)
    areas = [f"area {row['asked']:.0%}" for row in card["white_box"]]
    zoo = [f"zoo {row['name']}" for row in card["black_box"]["zoo"]]
    hidden = pictures.get("hidden", {})
    smallest = next((part for part in (*areas, *zoo) if hidden.get(part)), None)
    parts = [part for part in dict.fromkeys((smallest, "circle")) if part and hidden.get(part)]
    pair = lambda part, told: dict(told, own=shot(part, told["clothing"]), worn=shot(part, told["logo"]))
    cloaks = [(told, folder / place_of(told["part"])) for told in pictures.get("cloaks", [])]
    return {
        "hidden": {part: [pair(part, told) for told in hidden[part]] for part in parts},
        "missed": [dict(told, shot=shot("clean", told["clothing"])) for told in pictures.get("missed", [])],
        "alarms": [dict(told, shot=shot("clean", told["bare"])) for told in pictures.get("alarms", [])],
        "cloaks": [told | {side: page.data_uri(place / told[side]) for side in SIDES} for told, place in cloaks],
    }
