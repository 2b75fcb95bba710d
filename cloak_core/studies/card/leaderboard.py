"""The card's tables: the attacks on its page, its line in a leaderboard, and many cards as one Markdown table.

To add a figure, compute it in `statistics_card` and give it a column here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from cloak_core.core.evaluation.controls import CLOTHING
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_text
from cloak_core.studies.card.protocol import ENOUGH, VERSION
from cloak_core.studies.report.words import file_name, interval, percent, short_name

HEAD = """# Leaderboard

Written by `cloak assess --out DIR --leaderboard FILE` from the cards in DIR; [defence.md](defence.md) says what they
measure. All figures at the threshold at which each detector is run, with 95 % intervals; an arrow points to what is
better for whoever runs the detector. *76 % ↓*: the share of people whom the detector does not report when a cloak made
against it covers that share of the body, from the front; *all around*: the largest cloak, trained and judged in the
full circle; *others' cloaks*: the zoo's best one that was not made against the detector; *photographs*, where a card
has them: the worst that people in photographs wore. The most robust come first, by the mean over the areas. Rows of
different budgets do not compare; "from 40 % on" after a budget says that time allowed some parts no more than 40 % of
its steps and images.
"""


UNTRAINED = (CLOTHING, "grey", "random", "resampled")
"""What people in photographs wear as controls."""


def name_of(card: dict) -> str:
    """The detector's name, as pages call it."""
    return card.get("label") or short_name(card["spec"])


def worn_rows(card: dict) -> dict[str, dict]:
    """Select what people in photographs wore beside the controls: name -> S; empty where there were none."""
    rows = (card.get("photographs") or {}).get("rows", {})
    return {name: row for name, row in rows.items() if name not in UNTRAINED}


def _points(value: float) -> str:
    """0.512 -> "51.2", as average precision is printed."""
    return f"{100 * value:.1f}"


def attack_columns(card: dict) -> dict[str, Callable[[dict], str]]:
    """The columns of the table of attacks: head -> the cell of a row of `attack_record`."""
    return {
        f"hidden at its own {card['operating_point']}": lambda row: percent(row["success_own"]),
        "95 %": lambda row: interval(row["ci95_own"]),
        "hidden at 0.6": lambda row: percent(row["success"]),
        "95 % at 0.6": lambda row: interval(row["ci95"]),
        "mASR 0.1 – 0.9": lambda row: percent(row["masr"]),
        "AP50": lambda row: _points(row["ap50"]),
        "AP50:95": lambda row: _points(row["ap50_95"]),
        "something else there": lambda row: percent(row.get("renamed_own")),  # earlier versions' cards do not tell
        "nothing there": lambda row: percent(row.get("gone_own")),
        "random colours": lambda row: percent(row["random_own"]),
        "own clothing": lambda row: percent(row["clothing_own"]),
        "images": lambda row: str(row["n"]),
    }


def is_too_short(card: dict, row: dict) -> bool:
    """Whether the time left the attack of this row so few updates that people may hide far better."""
    full = card.get("counts", {}).get("steps", 0) * (2 if row is card.get("around") else 1)
    return row.get("steps", full) < ENOUGH * full


def at_least(card: dict, row: dict) -> str:
    """The mark before a share of hidden people that is a lower bound: the attack was too short."""
    return "≥ " if is_too_short(card, row) else ""


def leaderboard_row(card: dict) -> dict[str, str]:
    """The card's line in a leaderboard, column by column."""
    clean, attacks, black, around = card["clean"], card["white_box"], card["black_box"], card.get("around")
    worst = max(worn_rows(card).values(), key=lambda row: row["success_own"], default=None)
    # Of the parts that were done, the least share of its full size that the time allowed.
    least = min(filter(None, card.get("shares", {}).values()), default=1.0)
    return {
        "detector": name_of(card),
        **({"photographs ↓": _both(worst, "success_own")} if worst else {}),
        **{f"{percent(row['asked'])} ↓": at_least(card, row) + _both(row, "success_own") for row in reversed(attacks)},
        "all around ↓": at_least(card, around) + _both(around, "success_own") if around else "–",
        "others' cloaks ↓": percent(black["success_own"]) if black["counted"] else "–",
        "clean recall ↑": _both(clean, "recall_own"),
        "AP50 ↑": _points(clean["ap50"]),
        "false alarms ↓": percent(clean["false_alarms_own"]),
        "threshold": f"{card['operating_point']:g}",
        "budget": card["budget"] + (f",\nfrom {percent(least)} on" if least < 1 else ""),
    }


def leaderboard_table(cards: list[dict]) -> tuple[list[str], list[list[str]]]:
    """The heads and the cells of all cards' lines; a card without a column has "–" there."""
    rows = [leaderboard_row(card) for card in cards]
    heads = list(dict.fromkeys([*max(rows, key=len), *(key for row in rows for key in row)]))
    return heads, [[row.get(head, "–") for head in heads] for row in rows]


def _both(row: dict, key: str) -> str:
    """A share and, in a line of its own, its interval: a table of ten columns then fits a page."""
    return f"{percent(row[key])}\n({interval(row['ci95_own'])})"


# --- many cards


def gather(folder: Path) -> dict[str, dict]:
    """Read the cards in FOLDER/NAME/card.json, by their folder's name. InputError: none, or of another protocol."""
    cards = {path.parent.name: read_card(path) for path in sorted(folder.glob("*/card.json"))}
    if not cards:
        raise InputError(f"{folder}: holds no card; name a detector to assess")
    return cards


def folder_names(specs: Sequence[str]) -> dict[str, str]:
    """Name a folder for each detector: its short name, and a hash of its spec where others may share that name."""
    short = {spec: file_name(spec) for spec in specs}
    whole = {spec: set("@=") & set(spec) or list(short.values()).count(short[spec]) > 1 for spec in specs}
    return {
        spec: f"{name}-{sha256_record({'spec': spec})[:6]}" if whole[spec] else name for spec, name in short.items()
    }


def read_card(path: Path) -> dict:
    """Read a card.json. InputError: it is something else, or of another version."""
    card = read_json(path)
    if not str(card.get("format", "")).startswith("cloak card") or card.get("protocol") != VERSION:
        raise InputError(f"{path}: a card of protocol {card.get('protocol')!r}; this version has {VERSION!r}")
    return card


def markdown_rows(cards: list[dict]) -> list[str]:
    """Make a Markdown table of cards, one line each."""
    heads, rows = leaderboard_table(cards)
    lines = [heads, ["---"] * len(heads), *rows]
    return ["| " + " | ".join(cell.replace("|", "\\|").replace("\n", "<br>") for cell in line) + " |" for line in lines]


def write_leaderboard(cards: dict[str, dict], path: Path) -> None:
    """Write all cards, the most robust first: by how few people the white-box cloaks hide; those without one last."""
    ranked = sorted(cards.values(), key=lambda card: (_untested(card), _hidden(card), card["spec"]))
    made = dict.fromkeys(f"cloak {card['made']['cloak']}, torch {card['made'].get('torch', '?')}" for card in ranked)
    write_text(path, "\n".join([HEAD, *markdown_rows(ranked), "", f"Made with {'; '.join(made)}."]) + "\n")


def _untested(card: dict) -> int:
    """0: attacked in earnest; 1: too shortly or too little to be ranked with those; 2: not at all."""
    if not card["white_box"]:
        return 2
    dropped = 0 in card.get("shares", {}).values()
    return int(dropped or any(is_too_short(card, row) for row in card["white_box"]))


def _hidden(card: dict) -> float:
    rows = card["white_box"]
    return sum(row["success_own"] for row in rows) / len(rows) if rows else 1.0
