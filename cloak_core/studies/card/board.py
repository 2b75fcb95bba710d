"""A folder of cards as a leaderboard: what is checked before a card joins, and the page that sorts and filters them."""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from markupsafe import Markup

from cloak_core.core.evaluate import MEASUREMENT_VERSION
from cloak_core.files.errors import InputError
from cloak_core.files.reading import MAX_TEXT_BYTES, read_text
from cloak_core.files.writing import written
from cloak_core.studies.card.figures import ROWS, differences
from cloak_core.studies.card.leaderboard import leaderboard_table, ranked, read_card, write_leaderboard
from cloak_core.studies.card.page import CARD, write_card
from cloak_core.studies.card.protocol import SIZES
from cloak_core.studies.report import page
from cloak_core.studies.report.words import short_names
from cloak_core.studies.training_store import TRAINING_VERSION

FIELDS = {
    "spec": str,
    "size": str,
    "versions": dict,
    "operating_point": (int, float),
    "differentiable": bool,
    "partial_gradient": str,
    "made": dict,
    "counts": dict,
    "materials": dict,
    "clean": dict,
    "recall_by": dict,
    "controls": dict,
    "white_box": list,
    "black_box": dict,
    "patterns": list,
    "left_patterns": list,
    "not_tested": list,
    "seconds": (int, float),
    "state": str,
}
"""What a card has, beside `format` and `protocol`, and of which kind."""
SHARED = ("bodies", "unseen", "backgrounds", "unseen_backgrounds")
"""Materials that all cards of a leaderboard have in common."""
KEPT = ("card.json", "pictures.json", "pictures", ROWS)
"""What of a card's folder joins; its pages are written anew."""


def check_card(folder: Path, digest: str | None = None) -> dict:
    """Check that a card is whole, of this protocol and these versions, and that its figures follow from its rows.

    digest: of the detector, where it is at hand. InputError: names file and field of the first thing that does not
    hold.
    """
    path = folder / "card.json"
    card = read_card(path)
    for name, kind in FIELDS.items():
        if not isinstance(card.get(name), kind):
            raise InputError(f"{path}: {name} is {card.get(name)!r}" if name in card else f"{path}: {name} is missing")
    versions = {"training": TRAINING_VERSION, "measurement": MEASUREMENT_VERSION}
    for name, version in versions.items():
        if card["versions"].get(name) != version:
            raise InputError(f"{path}: versions.{name} is {card['versions'].get(name)!r}; this version has {version}")
    told = _digest(path, card)
    if digest is not None and told != digest:
        raise InputError(f"{path}: materials.detectors.{card['spec']} is {told[:12]}, the detector's is {digest[:12]}")
    try:
        _check_counts(path, card)
        wrong = next(differences(card, folder), None)
    except InputError:
        raise
    except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
        raise InputError(f"{path}: not the figures of a card ({type(error).__name__}: {error})") from None
    if wrong is not None:
        raise InputError(f"{path}: {wrong}")
    return card


def _check_counts(path: Path, card: dict) -> None:
    """Compare a card's counts with those of its size. InputError: one differs, or there is no such size."""
    if card["size"] not in SIZES:
        raise InputError(f"{path}: size is {card['size']!r}, none of {', '.join(SIZES)}")
    size = SIZES[card["size"]]
    for name, count in vars(size).items():
        said = card["counts"].get(name)
        if said != (list(count) if isinstance(count, tuple) else count):
            raise InputError(f"{path}: counts.{name} is {said!r}; size {size.name} has {count!r}")
    steps = [(f"white_box.{100 * row['asked']:g}", row["steps"], size.steps) for row in card["white_box"]]
    steps += [("around", card["around"]["steps"], 2 * size.steps)] if card.get("around") else []
    for place, made, asked in steps:
        if made != asked:
            raise InputError(f"{path}: {place}.steps is {made}; size {size.name} has {asked}")


def _digest(path: Path, card: dict) -> str:
    digests = card["materials"].get("detectors")
    if not isinstance(digests, dict) or list(digests) != [card["spec"]] or not isinstance(digests[card["spec"]], str):
        raise InputError(f"{path}: materials.detectors has no digest of {card['spec']}")
    return digests[card["spec"]]


def check_together(cards: Mapping[Path, dict]) -> None:
    """Check that cards compare: the same bodies and backgrounds, the same people, one digest for each detector.

    InputError: names the file and the field of one that differs from an earlier one.
    """
    known: dict[tuple[str, ...], tuple[object, Path]] = {}
    for folder, card in cards.items():
        materials, path = card["materials"], folder / "card.json"
        fields = {("materials", name, "sha256"): materials.get(name, {}).get("sha256") for name in SHARED}
        fields[("materials", "detectors", card["spec"])] = _digest(path, card)
        if card.get("photographs"):
            people = materials.get("shown_people", {}).get("sha256")
            fields[("materials", "shown_people", "sha256", card["size"])] = people
        for field, value in fields.items():
            before, where = known.setdefault(field, (value, path))
            if value != before:
                raise InputError(f"{path}: {'.'.join(field[:3])} differs from that of {where}: they do not compare")


def cards_in(folder: Path) -> list[Path]:
    """List the folders of the cards in a leaderboard's folder."""
    return [path.parent for path in sorted(folder.glob("*/card.json"))]


def add_cards(sources: Sequence[Path], board: Path, digests: Mapping[str, str]) -> list[Path]:
    """Check cards and copy them into a leaderboard's folder; none where one of them does not hold.

    digests: of detectors that are at hand, by spec. InputError: see `check_card` and `check_together`.
    """
    checked = {folder: check_card(folder, None) for folder in sources}
    for folder, card in checked.items():
        if card["spec"] in digests:
            check_card(folder, digests[card["spec"]])
    names = {folder.name for folder in sources}
    if len(names) < len(sources):
        raise InputError("leaderboard add: two of the cards' folders have one name")
    stay = [folder for folder in cards_in(board) if folder.name not in names]
    check_together({folder: read_card(folder / "card.json") for folder in stay} | checked)
    joined = []
    for source in sources:
        target = board / source.name
        if target.resolve() != source.resolve():
            with written(target):
                shutil.rmtree(target, ignore_errors=True)
                target.mkdir(parents=True)
                for name in KEPT:
                    if (source / name).is_dir():
                        shutil.copytree(source / name, target / name)
                    elif (source / name).is_file():
                        shutil.copy(source / name, target / name)
        joined.append(target)
    return joined


def build_board(folder: Path) -> tuple[list[Path], list[dict]]:
    """Check every card of a folder and write its pages, index.html and leaderboard.md; return the files and cards.

    InputError: there is no card, or one does not hold.
    """
    folders = cards_in(folder)
    if not folders:
        raise InputError(f"{folder}: holds no card (NAME/card.json)")
    cards = {one: check_card(one) for one in folders}
    check_together(cards)
    called = short_names(card["spec"] for card in cards.values())
    links = {}
    for one, card in cards.items():
        write_card(one)
        card["label"] = called[card["spec"]]
        links[id(card)] = f"{one.name}/{CARD}"
    ordered = ranked(cards.values())
    write_leaderboard({one.name: card for one, card in cards.items()}, folder / "leaderboard.md")
    heads, rows = leaderboard_table(ordered)
    script = read_text(page.TEMPLATES / "board.js", MAX_TEXT_BYTES)  # our own file
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    values = {
        "title": "Leaderboard",
        "heads": heads,
        "rows": [(links[id(card)], row) for card, row in zip(ordered, rows, strict=True)],
        "sizes": [name for name in SIZES if any(card["size"] == name for card in ordered)],
        "script": Markup(script),
        "script_digest": digest,
        "made": json.dumps(sorted({card["made"]["cloak"] for card in ordered})),
    }
    return [page.write_page(folder / "index.html", "board.html", values), folder / "leaderboard.md"], ordered
