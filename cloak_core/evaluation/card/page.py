"""A card as one HTML page that opens offline, and several side by side; from card.json and the pictures beside it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

from markupsafe import Markup

from cloak_core.evaluation.card import figures, words
from cloak_core.evaluation.card.leaderboard import markdown_rows, read_card
from cloak_core.evaluation.card.pictures import first_part, place_of
from cloak_core.evaluation.figures import style
from cloak_core.evaluation.report import page as report
from cloak_core.evaluation.report.words import duration
from cloak_core.files.reading import MAX_TEXT_BYTES, read_json, read_text
from cloak_core.files.writing import write_text

HERE = Path(__file__).parent
CARD = "card.html"


def write_card(folder: Path) -> Path:
    """Write FOLDER/card.html and card.md (a leaderboard's line) from FOLDER/card.json and pictures.json; the page."""
    card = read_card(folder / "card.json")
    write_text(folder / "card.md", "\n".join(markdown_rows([card])) + "\n")
    write_text(folder / CARD, _card(card, folder))
    return folder / CARD


def write_comparison(folders: Mapping[str, Path], path: Path) -> Path:
    """Write one page that compares the cards in these folders, named by their keys; it links to each one's own page."""
    cards = {name: read_card(folder / "card.json") | {"label": name} for name, folder in folders.items()}
    with style(**{"svg.fonttype": "none"}):
        shown = {
            "People hidden against the cloak's area, at each one's own threshold": figures.areas_of(
                list(cards.values())
            ),
            "Found in own clothing": figures.recall(list(cards.values())),
        }
        drawn = {name: report.svg(figure) for name, figure in shown.items()}
    rows = [words.leaderboard_row(card) for card in cards.values()]
    heads = list(dict.fromkeys([*max(rows, key=len), *(key for row in rows for key in row)]))
    links = {name: Path(os.path.relpath(folder / CARD, path.parent)).as_posix() for name, folder in folders.items()}
    page = {
        "title": "Robustness cards",
        "cards": [_summary(card) | {"link": links[name]} for name, card in cards.items()],
        "heads": heads,
        "rows": [[row.get(head, "–") for head in heads] for row in rows],
        "figures": drawn,
        "mixed": len({(card["budget"], card["seed"]) for card in map(_circumstances, cards.values())}) > 1,
    }
    write_text(path, _render("compare.html", page))
    return path


def _circumstances(card: dict) -> dict:
    return {"budget": card["budget"], "seed": card["made"]["seed"]}


def _summary(card: dict) -> dict:
    return {
        "name": words.name_of(card),
        "spec": card["spec"],
        "headline": words.headline(card),
        "verdict": words.verdict(card),
        "tiles": words.tiles(card),
    }


def _card(card: dict, folder: Path) -> str:
    pictures = read_json(folder / "pictures.json") if (folder / "pictures.json").exists() else {}
    page = _summary(card) | {
        "card": card,
        "lede": words.lede(card),
        "not_tested": words.not_tested(card),
        "figures": _figures(card),
        "pictures": _pictures(card, pictures, folder / "pictures"),
        "size": card["counts"]["size"],
        "spent": duration(card["seconds"]),
        "text": json.dumps({key: card[key] for key in ("counts", "materials", "made")}, indent=2),
    }
    return _render("card.html", page)


def _render(template: str, page: dict) -> str:
    css = Markup(read_text(report.HERE / "style.css", MAX_TEXT_BYTES) + read_text(HERE / "card.css", MAX_TEXT_BYTES))
    return report.environment(HERE).get_template(template).render(page | {"css": css})


def _figures(card: dict) -> dict[str, Markup]:
    with style(**{"svg.fonttype": "none"}):
        drawn = {"recall": figures.recall([card]), "bodies": figures.bodies(card), "controls": figures.controls(card)}
        if card["white_box"]:
            drawn |= {"area": figures.by_area(card), "threshold": figures.by_threshold(card)}
        if card.get("around"):
            drawn["around"] = figures.around(card)
        if card["black_box"]["zoo"]:
            drawn["zoo"] = figures.zoo(card)
        return {name: report.svg(figure) for name, figure in drawn.items()}


def _pictures(card: dict, pictures: dict, folder: Path) -> dict:
    """What pictures.json tells, with the pictures as data."""
    spec = card["spec"]
    shot = lambda part, told: report.told_shot(folder / place_of(part), [spec], told)
    areas = [f"area {row['asked']:.0%}" for row in card["white_box"]]
    zoo = [f"zoo {row['name']}" for row in card["black_box"]["zoo"]]
    hidden, smallest = pictures.get("hidden", {}), first_part([*areas, *zoo], pictures.get("hidden", {}))
    parts = [part for part in dict.fromkeys((smallest, "circle")) if part and hidden.get(part)]
    return {
        "hidden": {part: [_pair(shot, part, pair) for pair in hidden[part]] for part in parts},
        "missed": [dict(told, shot=shot("clean", told["clothing"])) for told in pictures.get("missed", [])],
        "alarms": [dict(told, shot=shot("clean", told["bare"])) for told in pictures.get("alarms", [])],
        "cloaks": [
            {"part": told["part"]}
            | {side: report.data_uri(folder / place_of(told["part"]) / told[side]) for side in ("front", "back")}
            for told in pictures.get("cloaks", [])
        ],
    }


def _pair(shot: object, part: str, pair: dict) -> dict:
    return dict(pair, own=shot(part, pair["clothing"]), worn=shot(part, pair["logo"]))
