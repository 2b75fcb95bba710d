"""`cloak assess`: a robustness card for any detector; `cloak leaderboard`: cards of others, checked and compared."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional, UseAppendAction

from cloak_core.commands.base import Command, command_line, err, out
from cloak_core.commands.options import Detecting, Splitting
from cloak_core.commands.progress import WorkProgress
from cloak_core.commands.sharing import Sharing
from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    from cloak_core.core.detector.protocol import Detector
    from cloak_core.core.source import Cast
    from cloak_core.studies.card.assess import Assessment
    from cloak_core.studies.card.gate import Bound
    from cloak_core.studies.card.protocol import Size


@dataclass(kw_only=True)
class Assess(Splitting, Detecting, Sharing):
    """Measure how robust detectors are, by a fixed protocol: a card for each.

    A card is figures and an offline page. The same command goes on where it stopped; without SPECS it writes pages and
    leaderboard again.
    """

    example = "builtin --quick --out cards"

    specs: Positional[tuple[str, ...]] = ()
    """Detectors (cloak detectors list); one without gradients gets the black-box part alone."""
    out: Path
    """Folder for NAME/card.json, card.html and card.md, and card.html over all."""
    size: Literal["quick", "standard", "full"] | None = None
    """quick: the largest cloak, ten minutes at 100 ms an image; standard (default): four areas, an hour; full: three
    seeds."""
    quick: bool = False
    """--size quick."""
    full: bool = False
    """--size full."""
    minutes: float | None = None
    """Take the largest size that fits into this many minutes a card."""
    people: str | None = None
    patterns: tuple[str, ...] = ()
    """Published patterns: FILE.png[@tile=METRES | @patch=METRES], or a folder with patterns.toml."""
    logo: str | None = None
    """(default: shirt and trousers)"""
    zoo: UseAppendAction[tuple[str, ...]] = ()
    """Entries of the zoo to show (default: all that these bodies can wear)."""
    seed: int = 0
    leaderboard: Path | None = None
    """Markdown file for a table of all cards in --out."""
    gate: Path | None = None
    """TOML file of bounds on figures of card.json, [min] and [max]; exit code 1 where one is broken."""
    junit: Path | None = None
    """JUnit XML file of --gate's bounds, for CI."""

    def run(self) -> dict:
        from cloak_core.detectors.naming import full_spec
        from cloak_core.studies.card.gate import check, require_measured, write_junit
        from cloak_core.studies.card.leaderboard import gather, write_leaderboard
        from cloak_core.studies.card.page import write_card, write_comparison
        from cloak_core.studies.report.words import short_names

        self.specs = tuple(dict.fromkeys(map(full_spec, self.specs)))
        self._sizes()
        bounds = self._bounds()
        self.sharing.spread(self._parts(), self.compute)
        cards = self.work() if self.specs else gather(self.out)
        for card in cards.values() if bounds and not self.specs else ():
            require_measured(self.gate, bounds, card)
        called = short_names(card["spec"] for card in cards.values())
        folders = {called[card["spec"]]: self.out / name for name, card in cards.items()}
        pages = [write_card(folder) for folder in folders.values()]
        pages += [write_comparison(folders, self.out / "card.html")] if len(cards) > 1 else []
        if self.leaderboard is not None:
            write_leaderboard(gather(self.out).values(), self.leaderboard)
            pages.append(self.leaderboard)
        more = {"files": [str(path) for path in pages]}
        if bounds:
            checked = {card["spec"]: check(card, bounds) for card in cards.values()}
            more["broken"] = [words for problems in checked.values() for words in problems.values() if words]
            if self.junit is not None:
                write_junit(self.junit, checked)
        if len(cards) == 1:
            return next(iter(cards.values())) | more
        return {"cards": {card["spec"]: card for card in cards.values()}} | more

    def failures(self, result: dict) -> list[str]:
        return result.get("broken", [])

    def _bounds(self) -> list[Bound]:
        """Read the gate, before anything is measured."""
        from cloak_core.studies.card.gate import read_gate

        if self.junit is not None and self.gate is None:
            raise InputError("--junit: needs --gate FILE")
        return [] if self.gate is None else read_gate(self.gate)

    def _parts(self) -> list[tuple[str, Assess]]:
        return [(spec, self.part_of(leaderboard=None, junit=None, specs=(spec,))) for spec in dict.fromkeys(self.specs)]

    def _sizes(self) -> list[Size]:
        """List the sizes that this call may take, the largest first; one where no time is given."""
        from cloak_core.studies.card.protocol import SIZES

        names = [self.size] * (self.size is not None) + ["quick"] * self.quick + ["full"] * self.full
        if len(names) + (self.minutes is not None) > 1:
            raise InputError("--size, --quick, --full, --minutes: one of them")
        if self.minutes is None:
            return [SIZES[names[0] if names else "standard"]]
        if not self.minutes > 0:
            raise InputError(f"--minutes {self.minutes:g}: some time is needed")
        return list(SIZES.values())[::-1]

    def work(self) -> dict[str, dict]:
        """Make a card for each detector, by its folder's name."""
        from cloak_core.studies.card.gate import require_measured
        from cloak_core.studies.card.leaderboard import folder_names
        from cloak_core.studies.opening import cloth_spec
        from cloak_core.studies.wearing.patterns import pattern_specs

        self.prepare()
        patterns = tuple(cloth_spec(spec) for named in self.patterns for spec in pattern_specs(named))
        people, names, bounds = self.cast(), folder_names(self.specs), self._bounds()
        assessments = {
            names[spec]: self._choose(spec, detector, self.out / names[spec], people, patterns)
            for spec, detector in self.by_spec(self.specs).items()
        }
        for assessment in assessments.values() if bounds else ():
            require_measured(self.gate, bounds, assessment.expected())
        return {name: assessment.run() for name, assessment in assessments.items()}

    def _choose(
        self, spec: str, detector: Detector, folder: Path, people: Cast, patterns: tuple[str, ...]
    ) -> Assessment:
        """Take the largest size that fits into the time, if one is given, and say how long it will take.

        InputError: not even the smallest fits.
        """
        from cloak_core.core.evaluation.settings import StoreOptions
        from cloak_core.studies.card.assess import Assessment
        from cloak_core.studies.report.words import short_name
        from cloak_core.studies.store import RunStore

        split, pace = self.split({spec: detector}, with_people=False), None
        made = StoreOptions(out=self.out, seed=self.seed, device=self.compute.device, command=command_line())
        for size in self._sizes():
            store = RunStore(split, replace(made, seeds=size.seeds, size=size.pixels), lambda message: None)
            assessment = Assessment(store, size, folder, self.zoo or None, WorkProgress(), people, patterns, self.logo)
            seconds, pace = assessment.seconds_left(pace)
            clocked = f"{1000 * pace.gradient:.0f} ms a forward and backward, {1000 * pace.forward:.0f} ms a forward"
            about = f"about {max(1, round(seconds / 60))} min on this machine (measured: {clocked})"
            if self.minutes is None or seconds <= 60 * self.minutes:
                err.print(f"assessing {short_name(spec)}, size {size.name}: {about}")
                return assessment
        raise InputError(f"--minutes {self.minutes:g}: {spec}: size {size.name}, the smallest, takes {about}")

    def show(self, result: dict) -> None:
        from cloak_core.studies.card.words import headline, lede

        for card in result["cards"].values() if "cards" in result else [result]:
            out.print(headline(card))
            out.print(f"  {lede(card)}")
        for path in result["files"]:
            out.print(f"wrote {path}")

    def following(self, result: dict) -> tuple[str, ...]:
        made = [
            path.parent for path in map(Path, result["files"]) if path.name == "card.html" and path.parent != self.out
        ]
        return ("leaderboard", "add", *map(str, made)) if made else ()


@dataclass(kw_only=True)
class Add(Detecting):
    """Check robustness cards, every figure by the rows beside it, and put them into a leaderboard's folder.

    They replace those of the same detector and size; nothing is written where one does not hold.
    """

    example = "cards/builtin --to leaderboard"
    then = "leaderboard build {to}"

    cards: Positional[tuple[str, ...]]
    """Folders of cloak assess (CARDS/NAME), or their card.json."""
    to: Path = Path("leaderboard")
    """Folder of the leaderboard's cards."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """Detectors at hand, by the cards' specs: cards are held against them, too."""

    def run(self) -> dict:
        from cloak_core.studies.card.leaderboard import add_cards

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
    """Folder of cards: NAME/card.json, with rows beside it."""

    def run(self) -> dict:
        from cloak_core.studies.card.leaderboard import build_board

        files, cards = build_board(self.folder)
        return {"cards": [card["spec"] for card in cards], "files": [str(path) for path in files]}

    def show(self, result: dict) -> None:
        out.print(f"{len(result['cards'])} cards: every figure holds")
        for path in result["files"]:
            out.print(f"wrote {path}")
