"""Many cards as one Markdown table: written by `cloak assess`, never by hand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cloak_core.evaluation.card.protocol import VERSION
from cloak_core.evaluation.card.words import leaderboard_row
from cloak_core.evaluation.report.words import file_name
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_text

HEAD = """# Leaderboard

Written by `cloak assess --out DIR --leaderboard FILE` from the cards in DIR; [defence.md](defence.md) says what they
measure. All figures at the threshold at which each detector is run, with 95 % intervals. *Hidden, 5 %*: the share of
people whom the detector does not report when a cloak made against it covers that share of the body, from the front;
*mASR*: the largest cloak's mean success over the thresholds 0.1 to 0.9; *all around*: the largest cloak, trained and
judged in the full circle; *others' cloaks*: the zoo's best one that was not made against the detector.
Low is good for whoever runs the detector, but for clean recall and AP. Rows of different budgets do not compare.
"""


def gather(folder: Path) -> dict[str, dict]:
    """The cards in FOLDER/NAME/card.json, by their folder's name. InputError: there is none, or one of another
    protocol."""
    cards = {path.parent.name: read_card(path) for path in sorted(folder.glob("*/card.json"))}
    if not cards:
        raise InputError(f"{folder}: holds no card; name a detector to assess")
    return cards


def folder_names(specs: Sequence[str]) -> dict[str, str]:
    """A folder's name for each detector: what it is called in short, and where that may be said of others too, a mark
    of its spec."""
    short = {spec: file_name(spec) for spec in specs}
    whole = {spec: set("@=") & set(spec) or list(short.values()).count(short[spec]) > 1 for spec in specs}
    return {
        spec: f"{name}-{sha256_record({'spec': spec})[:6]}" if whole[spec] else name for spec, name in short.items()
    }


def read_card(path: Path) -> dict:
    """A card.json. InputError: it is something else, or of another version."""
    card = read_json(path)
    if not str(card.get("format", "")).startswith("cloak card") or card.get("protocol") != VERSION:
        raise InputError(f"{path}: a card of protocol {card.get('protocol')!r}; this version has {VERSION!r}")
    return card


def markdown_rows(cards: list[dict]) -> list[str]:
    """A Markdown table of cards, one line each."""
    rows = [leaderboard_row(card) for card in cards]
    longest = max(rows, key=len)
    heads = list(dict.fromkeys([*longest, *(key for row in rows for key in row)]))
    lines = [heads, ["---"] * len(heads), *([row.get(head, "–") for head in heads] for row in rows)]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]


def write_leaderboard(cards: dict[str, dict], path: Path) -> None:
    """All cards, the most robust first: by how few people the white-box cloaks hide, those without one last."""
    ranked = sorted(cards.values(), key=lambda card: (not card["white_box"], _hidden(card), card["spec"]))
    made = dict.fromkeys(f"cloak {card['made']['cloak']}, torch {card['made'].get('torch', '?')}" for card in ranked)
    write_text(path, "\n".join([HEAD, *markdown_rows(ranked), "", f"Made with {'; '.join(made)}."]) + "\n")


def _hidden(card: dict) -> float:
    rows = card["white_box"]
    return sum(row["success_own"] for row in rows) / len(rows) if rows else 1.0
