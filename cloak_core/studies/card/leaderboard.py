"""The card's tables: the attacks on its page, its line in a leaderboard, and many cards as one table.

To add a figure, compute it in `figures` and give it a column here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.files.reading import read_json
from cloak_core.files.writing import write_text
from cloak_core.studies.card.protocol import VERSION
from cloak_core.studies.card.words import MEASURED, name_of, others_strongest, shown, strongest, whole
from cloak_core.studies.report.words import file_name, interval, markdown, percent

HEAD = """# Leaderboard

Written by `cloak leaderboard build DIR` from the cards in DIR; [card.md](card.md) says what
they measure. All figures at the threshold at which each detector is run, with 95 % intervals; an arrow points to what
is better for whoever runs the detector. *photographs*: the worst that people in photographs wore; *76 % ↓*: the share
of people whom the detector does not report when a cloak made against it covers that share of the body, from the front;
*all around*: the largest cloak, trained and judged in the full circle; *others' cloaks*: the zoo's best one that was
not made against the detector. ≥: at least; –: not measured. Rows of different sizes do not compare.
"""


def attack_columns(card: dict) -> dict[str, Callable[[dict], str]]:
    """The columns of the table of attacks: head -> the cell of a row of `attack_record`."""
    return {
        f"hidden at its own {card['operating_point']}": shown,
        "95 %": lambda row: interval(row["ci95_own"]),
        "how sure": lambda row: row["state"],
        "hidden at 0.6": lambda row: percent(row["success"]),
        "95 % at 0.6": lambda row: interval(row["ci95"]),
        "hidden at 0.5": lambda row: percent(row["success_05"]),
        "mASR 0.1 – 0.9": lambda row: percent(row["masr"]),
        "AP50": lambda row: f"{100 * row['ap50']:.1f}",
        "AP50:95": lambda row: f"{100 * row['ap50_95']:.1f}",
        "something else there": lambda row: percent(row["renamed_own"]),
        "nothing there": lambda row: percent(row["gone_own"]),
        "random colours": lambda row: percent(row["random_own"]),
        "own clothing": lambda row: percent(row["clothing_own"]),
        "images": lambda row: str(row["n"]),
    }


def leaderboard_row(card: dict) -> dict[str, str]:
    """The card's line in a leaderboard, column by column; photographs first."""

    def both(row: dict | None, key: str = "success_own") -> str:
        # A share and, in a line of its own, its interval: a table of ten columns then fits a page.
        return f"{shown(row, key)}\n({interval(row['ci95_own'])})" if row else shown(row)

    clean, worn = card["clean"], strongest(card, True)
    return {
        "detector": name_of(card),
        "photographs ↓": both(worn and worn.row),
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
    names = list(short.values())
    for spec, name in short.items():
        if set("@=") & set(spec) or names.count(name) > 1:
            short[spec] = f"{name}-{sha256_record({'spec': spec})[:6]}"
    return short


def read_card(path: Path) -> dict:
    """Read a card.json. InputError: it is something else, or of another version."""
    card = read_json(path)
    if not str(card.get("format", "")).startswith("cloak card"):
        raise InputError(f"{path}: format is {card.get('format')!r}, not a cloak card")
    if card.get("protocol") != VERSION:
        raise InputError(f"{path}: protocol is {card.get('protocol')!r}; this version has {VERSION!r}")
    return card


def markdown_rows(cards: list[dict]) -> list[str]:
    """Make a Markdown table of cards, one line each."""
    heads, rows = leaderboard_table(cards)
    lines = [heads, ["---"] * len(heads), *rows]
    return ["| " + " | ".join(markdown(cell).replace("\n", "<br>") for cell in line) + " |" for line in lines]


def write_leaderboard(cards: dict[str, dict], path: Path) -> None:
    """Write all cards as a Markdown table, in the order of `ranked`."""
    ordered = ranked(cards.values())
    made = dict.fromkeys(f"cloak {card['made']['cloak']}, torch {card['made'].get('torch', '?')}" for card in ordered)
    write_text(path, "\n".join([HEAD, *markdown_rows(ordered), "", f"Made with {markdown('; '.join(made))}."]) + "\n")


def ranked(cards: Iterable[dict]) -> list[dict]:
    """Order cards, the most robust first; those whose white box is short or was not measured come last.

    Robust: by the strongest attack on people in photographs, where any were shown, then the mean over the areas.
    """

    def place(card: dict) -> tuple:
        rows, worn = card["white_box"], strongest(card, True)
        mean = sum(row["success_own"] for row in rows) / len(rows) if rows else 1.0
        in_photographs = worn.row["success_own"] if worn else 1.0
        return whole(card) != MEASURED, not rows, in_photographs, mean, card["spec"]

    return sorted(cards, key=place)
