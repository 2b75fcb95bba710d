"""Many cards: which join a leaderboard, in which order, and the page and the table of them."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from markupsafe import Markup

from cloak_core.core.detector.protocol import Detector, detector_record
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record
from cloak_core.files.reading import MAX_TEXT_BYTES, read_text
from cloak_core.files.writing import write_text, written
from cloak_core.studies.card.entry import read_entry, read_told, remove_card, write_entry
from cloak_core.studies.card.figures import DETECTOR, detector_facts
from cloak_core.studies.card.page import CARD, leaderboard_table, markdown_rows, read_card, write_card
from cloak_core.studies.card.protocol import SIZES
from cloak_core.studies.card.words import MEASURED, strongest, whole
from cloak_core.studies.opening import CLOTHES
from cloak_core.studies.report import page
from cloak_core.studies.report.words import file_name, markdown, short_names

HEAD = """# Leaderboard

Written by `cloak leaderboard build DIR` from the cards in DIR; [card.md](card.md) says what
they measure. All figures at the threshold at which each detector is run, with 95 % intervals; an arrow points to what
is better for whoever runs the detector. *photographs*: the worst that people in photographs wore; *76 % ↓*: the share
of people whom the detector does not report when a cloak made against it covers that share of the body, from the front;
*all around*: the largest cloak, trained and judged in the full circle; *others' cloaks*: the zoo's best one that was
not made against the detector. ≥: at least; –: not measured. Rows of different sizes do not compare.
"""
SHARED = ("bodies", "unseen", "backgrounds", "unseen_backgrounds")
"""Materials that all cards of a leaderboard have in common."""


def check_together(cards: Mapping[Path, dict], detectors: Mapping[str, Detector] | None = None) -> None:
    """Check that cards compare: the same bodies, backgrounds, people and cloaks of the zoo, one network for each spec.

    cards: what they say themselves (`entry.CARD`), by folder. detectors: those at hand, by spec. InputError: names the
    file and the place of one that differs from an earlier one.
    """
    known: dict[tuple[str, str], tuple[object, object]] = {}
    for spec, detector in (detectors or {}).items():
        facts = _of_detector(spec, detector_facts(detector), sha256_record(detector_record(detector)))
        known |= {place: (value, "the detector at hand") for place, value in facts.items()}
    for folder, card in cards.items():
        path = folder / "card.json"
        for place, value in _common(card).items():
            before, where = known.setdefault(place, (value, path))
            if value != before:
                raise InputError(f"{path}: {place[0]} differs from that of {where}: they do not compare")


def _common(card: dict) -> dict[tuple[str, str], object]:
    """List what a card has in common with others, by place, and of which spec or size if not of all."""
    materials, spec, size = card["materials"], card["spec"], card["size"]
    common = {("cover", ""): card.get("cover") or CLOTHES}
    for name in SHARED:
        common |= {(f"materials.{name}.{key}", ""): value for key, value in materials[name].items() if key != "name"}
    common |= _of_detector(spec, card, materials["detectors"][spec])
    for asked, row in zip(SIZES[size].areas, card["white_box"], strict=False):
        common |= {(f"white_box.{100 * asked:g}.{key}", ""): row[key] for key in ("area", "faces")}
    for row in card["black_box"]["zoo"]:
        common |= {(f"black_box.zoo.{row['name']}.{key}", ""): row[key] for key in ("area", "unseen")}
    if card.get("photographs") is not None:
        common["materials.shown_people", size] = materials.get("shown_people")
        common["photographs.left_out", size] = card["photographs"]["left_out"]
    return common


def _of_detector(spec: str, facts: Mapping, digest: str) -> dict[tuple[str, str], object]:
    return {(f"materials.detectors.{spec}", spec): digest} | {(key, spec): facts[key] for key in DETECTOR}


def cards_in(folder: Path) -> list[Path]:
    """List the folders of the cards in a leaderboard's folder. InputError: one is a link."""
    folders = [path.parent for path in sorted(folder.glob("*/card.json")) if not path.parent.name.startswith(".")]
    for card in folders:
        if card.is_symlink():
            raise InputError(f"{card}: a link; a leaderboard holds its cards themselves")
    return folders


def add_cards(sources: Sequence[Path], board: Path, detectors: Mapping[str, Detector]) -> list[Path]:
    """Check cards and write them into a leaderboard's folder; none where one of them does not hold.

    A card replaces the one of the same detector and size. detectors: those at hand, by spec. Returns the cards'
    folders, which are named by their content. InputError: see `read_entry` and `check_together`.
    """
    entries = {folder: read_entry(folder) for folder in sources}
    there = {folder: read_told(folder)[1] for folder in cards_in(board)}
    check_together(there | {folder: entry.card for folder, entry in entries.items()}, detectors)
    joined: dict[tuple[str, str], Path] = {}
    for entry in entries.values():
        spec, size = entry.card["spec"], entry.card["size"]
        if (spec, size) in joined:
            raise InputError(f"leaderboard add: two cards are of {spec}, size {size}")
        joined[spec, size] = board / entry.name
    for entry in entries.values():
        write_entry(entry, board)
    for folder, card in there.items():
        if folder != joined.get((card["spec"], card["size"]), folder):
            with written(folder):
                remove_card(folder)
    return list(joined.values())


def build_board(folder: Path) -> tuple[list[Path], list[dict]]:
    """Check every card of a folder and write its pages, index.html and leaderboard.md; return the files and cards.

    InputError: there is no card, or one does not hold.
    """
    folders = cards_in(folder)
    if not folders:
        raise InputError(f"{folder}: holds no card (NAME/card.json)")
    cards = {path: read_entry(path).card for path in folders}
    check_together(cards)
    called = short_names(card["spec"] for card in cards.values())
    for path, card in cards.items():
        write_card(path)
        card |= {"label": called[card["spec"]], "link": f"{path.name}/{CARD}"}
    ordered = write_leaderboard(cards.values(), folder / "leaderboard.md")
    heads, rows = leaderboard_table(ordered)
    script = read_text(page.TEMPLATES / "board.js", MAX_TEXT_BYTES)  # our own file
    values = {
        "title": "Leaderboard",
        "heads": heads,
        "rows": [(card["link"], row) for card, row in zip(ordered, rows, strict=True)],
        "sizes": [name for name in SIZES if any(card["size"] == name for card in ordered)],
        "script": Markup(script),
        "script_digest": base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
    }
    return [page.write_page(folder / "index.html", "board.html", values), folder / "leaderboard.md"], ordered


# --- cards of `cloak assess`, and their order


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


def write_leaderboard(cards: Iterable[dict], path: Path) -> list[dict]:
    """Write all cards as a Markdown table, the most robust first, and return them in this order.

    Robust: by the strongest attack on people in photographs, where any were shown, then the mean over the areas. Cards
    whose white box is short or was not measured come last.
    """

    def place(card: dict) -> tuple:
        rows, worn = card["white_box"], strongest(card, True)
        mean = sum(row["success_own"] for row in rows) / len(rows) if rows else 1.0
        return whole(card) != MEASURED, not rows, worn["success_own"] if worn else 1.0, mean, card["spec"]

    ordered = sorted(cards, key=place)
    made = dict.fromkeys(f"cloak {card['made']['cloak']}, torch {card['made'].get('torch', '?')}" for card in ordered)
    write_text(path, "\n".join([HEAD, *markdown_rows(ordered), "", f"Made with {markdown('; '.join(made))}."]) + "\n")
    return ordered
