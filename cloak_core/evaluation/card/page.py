"""A card as one HTML page that opens offline, and several side by side; from card.json and the pictures beside it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

from markupsafe import Markup

from cloak_core.evaluation.card import leaderboard, words
from cloak_core.evaluation.card.leaderboard import markdown_rows, read_card
from cloak_core.evaluation.card.pictures import SIDES, place_of
from cloak_core.evaluation.report import page, plots_card
from cloak_core.evaluation.report.words import duration
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_text

CARD = "card.html"


def write_card(folder: Path) -> Path:
    """Write FOLDER/card.html and card.md (a leaderboard's line) from FOLDER/card.json and pictures.json."""
    card = read_card(folder / "card.json")
    pictures = read_json(folder / "pictures.json") if (folder / "pictures.json").exists() else {}
    write_text(folder / "card.md", "\n".join(markdown_rows([card])) + "\n")
    values = _summary(card) | {
        "card": card,
        "lede": words.lede(card),
        "not_tested": words.not_tested(card),
        "attack_heads": list(leaderboard.attack_columns(card)),
        "attacks": leaderboard.attack_rows(card),
        "figures": _figures(plots_card.card_figures(card)),
        "pictures": _pictures(card, pictures, folder / "pictures"),
        "size": card["counts"]["size"],
        "spent": duration(card["seconds"]),
        "text": json.dumps({key: card[key] for key in ("counts", "materials", "made")}, indent=2),
    }
    return page.write_page(folder / CARD, "card.html", values)


def write_comparison(folders: Mapping[str, Path], path: Path) -> Path:
    """Write one page that compares the cards in these folders, named by their keys; it links to each one's own page."""
    cards = {name: read_card(folder / "card.json") | {"label": name} for name, folder in folders.items()}
    links = {name: Path(os.path.relpath(folder / CARD, path.parent)).as_posix() for name, folder in folders.items()}
    heads, rows = leaderboard.leaderboard_table(list(cards.values()))
    values = {
        "title": "Robustness cards",
        "cards": [_summary(card) | {"link": links[name]} for name, card in cards.items()],
        "heads": heads,
        "rows": rows,
        "figures": _figures(plots_card.comparison_figures(list(cards.values()))),
        "mixed": len({(card["budget"], card["made"]["seed"]) for card in cards.values()}) > 1,
    }
    return page.write_page(path, "compare.html", values)


def _summary(card: dict) -> dict:
    return {
        "name": leaderboard.name_of(card),
        "spec": card["spec"],
        "headline": words.headline(card),
        "verdict": words.verdict(card),
        "tiles": words.tiles(card),
    }


def _figures(plots: Mapping[str, plots_card.Plot]) -> dict[str, Markup]:
    with page.page_style():
        return {name: page.svg(draw()) for name, draw in plots.items()}


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
