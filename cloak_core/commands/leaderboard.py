"""`cloak leaderboard`: check cards that others made, and build the page that compares them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional, UseAppendAction

from cloak_core.commands.base import Command, out
from cloak_core.commands.options import Detecting
from cloak_core.files.errors import InputError


@dataclass(kw_only=True)
class Add(Detecting):
    """Check robustness cards, every figure by the rows beside it, and put them into a leaderboard's folder.

    A card replaces the one of the same detector and size. Where one does not hold, nothing is written.
    """

    example = "cards/builtin --to leaderboard"
    then = "leaderboard build {to}"

    cards: Positional[tuple[str, ...]]
    """Folders that cloak assess wrote (CARDS/NAME), or their card.json."""
    to: Path = Path("leaderboard")
    """Folder of cards that is the leaderboard's source."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """Detectors that are at hand, by the cards' specs: cards are held against them, too."""

    def run(self) -> dict:
        from cloak_core.studies.card.board import add_cards

        if not self.cards:
            raise InputError("leaderboard add: which cards? (CARDS/NAME)")
        self.prepare()
        named = [Path(card) for card in self.cards]
        folders = [path.parent if path.name == "card.json" else path for path in named]
        joined = add_cards(folders, self.to, self.by_spec(self.detector))
        return {"added": [str(folder) for folder in joined]}

    def show(self, result: dict) -> None:
        for folder in result["added"]:
            out.print(f"{folder}: every figure holds")


@dataclass(kw_only=True)
class Build(Command):
    """Check every card of a leaderboard's folder again, and write its page (index.html, offline) and table."""

    example = "leaderboard"

    folder: Positional[Path]
    """Folder of cards: NAME/card.json, with the rows beside it."""

    def run(self) -> dict:
        from cloak_core.studies.card.board import build_board

        files, cards = build_board(self.folder)
        return {"cards": [card["spec"] for card in cards], "files": [str(path) for path in files]}

    def show(self, result: dict) -> None:
        out.print(f"{len(result['cards'])} cards: every figure holds")
        for path in result["files"]:
            out.print(f"wrote {path}")
