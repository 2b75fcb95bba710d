"""`cloak assess`: a robustness card for any detector."""

from __future__ import annotations

import shlex
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional, UseAppendAction

from cloak_core.commands.base import err, out
from cloak_core.commands.options import Detecting, Splitting
from cloak_core.commands.progress import WorkProgress
from cloak_core.commands.sharing import Sharing, SharingOptions
from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    from cloak_core.core.detector.protocol import Detector
    from cloak_core.studies.card.gate import Bound
    from cloak_core.studies.card.protocol import Budget
    from cloak_core.studies.store import RunStore


@dataclass(kw_only=True)
class Assess(Splitting, Detecting, Sharing):
    """Measure how robust detectors are, by a fixed protocol: a card for each.

    A card is figures and one page that opens offline; of several detectors, a page compares them.

    What is there already is not done again: a stopped call goes on with the same command. Without any SPEC the pages
    and the leaderboard are written again from the cards in --out.
    """

    example = "builtin --quick --out cards"

    specs: Positional[tuple[str, ...]] = ()
    """Detectors, as in cloak train; a detector without gradients gets the black-box part alone."""
    out: Path
    """Folder for NAME/card.json, NAME/card.html and NAME/card.md, and card.html over all detectors."""
    quick: bool = False
    """Short attacks and few images, fewer still where they do not fit into ten minutes (default: about an hour)."""
    full: bool = False
    """Long attacks, three seeds each, and many images."""
    minutes: float | None = None
    """Time for each card: steps and images follow the clock, and intervals say so (--quick: 10; else: any)."""
    people: str | None = None
    """People in photographs, as in cloak wear: they wear the largest cloak and the patterns, and come first."""
    patterns: tuple[str, ...] = ()
    """Published patterns to wear as cloth: FILE.png, 0.5 m wide, or FILE.png@tile=METRES."""
    zoo: UseAppendAction[tuple[str, ...]] = ()
    """Entries of the zoo to show it (default: all that these bodies can wear)."""
    seed: int = 0
    """Every random draw derives from it."""
    leaderboard: Path | None = None
    """Markdown file that takes a table of all cards in --out."""
    gate: Path | None = None
    """TOML file with bounds on figures of card.json, in tables [min] and [max] (clean.recall_own = 0.95); exit code 1
    where one is broken."""
    junit: Path | None = None
    """JUnit XML file of the bounds in --gate, for CI."""

    def run(self) -> dict:
        self._budget()
        bounds = self._bounds()
        self.sharing.spread(self._parts(), self.compute)
        cards = self.work() if self.specs else {}
        # Not before: `work` counts the time that it takes to load all this.
        from cloak_core.studies.card.gate import check, write_junit
        from cloak_core.studies.card.leaderboard import gather, write_leaderboard
        from cloak_core.studies.card.page import write_card, write_comparison
        from cloak_core.studies.report.words import short_names

        cards = cards or gather(self.out)
        called = short_names(card["spec"] for card in cards.values())
        folders = {called[card["spec"]]: self.out / name for name, card in cards.items()}
        pages = [write_card(folder) for folder in folders.values()]
        pages += [write_comparison(folders, self.out / "card.html")] if len(cards) > 1 else []
        if self.leaderboard is not None:
            write_leaderboard(gather(self.out), self.leaderboard)
            pages.append(self.leaderboard)
        more = {"files": [str(path) for path in pages]}
        if bounds:
            checked = {card["spec"]: check(card, bounds) for card in cards.values()}
            more["broken"] = [words for said in checked.values() for words in said.values() if words]
            if self.junit is not None:
                write_junit(self.junit, checked)
        if len(cards) == 1:
            return next(iter(cards.values())) | more
        return {"cards": {card["spec"]: card for card in cards.values()}} | more

    def failures(self, result: dict) -> list[str]:
        return result.get("broken", [])

    def _bounds(self) -> list[Bound]:
        """Read the gate, before anything is measured."""
        if self.junit is not None and self.gate is None:
            raise InputError("--junit: needs --gate FILE")
        from cloak_core.studies.card.gate import read_gate

        return [] if self.gate is None else read_gate(self.gate)

    def _parts(self) -> list[tuple[str, Assess]]:
        alone = replace(self, sharing=SharingOptions(), leaderboard=None, gate=None, junit=None)
        return [(spec, replace(alone, specs=(spec,))) for spec in dict.fromkeys(self.specs)]

    def _budget(self) -> Budget:
        from cloak_core.studies.card.protocol import DEFAULT, FULL, QUICK

        if self.quick and self.full:
            raise InputError("--quick, --full: one of them")
        if self.minutes is not None and not self.minutes > 0:
            raise InputError(f"--minutes {self.minutes:g}: some time is needed")
        budget = QUICK if self.quick else FULL if self.full else DEFAULT
        return budget if self.minutes is None else replace(budget, minutes=self.minutes)

    def _patterns(self) -> tuple[str, ...]:
        """List the patterns with their widths. InputError: one cannot be read."""
        from cloak_core.studies.wearing.clothes import cloth_spec, read_clothes

        patterns = tuple(map(cloth_spec, self.patterns))
        for spec in patterns:
            read_clothes(spec)
        return patterns

    def work(self) -> dict[str, dict]:
        """Make a card for each detector, by its folder's name."""
        from cloak_core.sources.photographs.people import load_people
        from cloak_core.studies.card.assess import Assessment
        from cloak_core.studies.card.leaderboard import folder_names

        began = time.monotonic()
        self.prepare()
        budget, specs, patterns = self._budget(), tuple(dict.fromkeys(self.specs)), self._patterns()
        people = None if self.people is None else load_people(self.people, self.images)
        names, cards = folder_names(specs), {}
        for spec, detector in self.by_spec(specs).items():
            err.print(f"assessing {spec}")
            store = self._store(spec, detector, budget)
            folder, zoo = self.out / names[spec], self.zoo or None
            assessment = Assessment(store, budget, folder, zoo, WorkProgress(), people, patterns, began)
            cards[names[spec]] = assessment.run()
            began = time.monotonic()
        return cards

    def _store(self, spec: str, detector: Detector, budget: Budget) -> RunStore:
        from cloak_core.core.evaluation.settings import StoreOptions
        from cloak_core.studies.store import RunStore

        options = StoreOptions(
            out=self.out,
            seeds=budget.seeds,
            seed=self.seed,
            device=self.compute.device,
            command=shlex.join(["cloak", *sys.argv[1:]]),
        )
        return RunStore(self.split({spec: detector}, with_people=False), options, lambda message: None)

    def show(self, result: dict) -> None:
        from cloak_core.studies.card.words import headline, lede

        for card in result["cards"].values() if "cards" in result else [result]:
            out.print(headline(card))
            out.print(f"  {lede(card)}")
        for path in result["files"]:
            out.print(f"wrote {path}")
