"""`cloak people ...`: people in photographs, before anything is worn by them."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from cloak_core.commands.base import Command, left_out, out
from cloak_core.commands.progress import counted
from cloak_core.commands.sharing import executor_of


@dataclass(kw_only=True)
class Fit(Command):
    """Fit the body to people in photographs ahead of need, and count them.

    Other commands do so on their own; fits are found again by content, in the cache (CLOAK_CACHE).
    """

    example = "people.json"

    people: Positional[str]
    """COCO file of people: masks, and COCO keypoints or BlazePose landmarks; PEOPLE.json[0::2] takes photographs."""
    images: Path | None = None
    """Folder of the photographs (default: beside the file, or images/ beside it)."""
    ray: str | None = None
    """Have a Ray cluster fit: local, or an address (auto, HOST:6379, ray://HOST:10001) (default: all cores here)."""

    def run(self) -> dict:
        from cloak_core.sources.photographs.fits import fit_people, those_who_fit
        from cloak_core.sources.photographs.people import load_people

        people, executor = load_people(self.people, self.images), executor_of(self.ray)
        with counted("fitting", unit="people") as tell:
            fits = fit_people(people, tell, executor)
        fitting, qualities = those_who_fit(people, fits), list(fits.qualities())
        return {
            "people": len(fitting),
            "photographs": len(fitting.photographs),
            "left_out": fitting.left_out,
            "covered": statistics.median(quality["covered"] for quality in qualities),
            "spilled": statistics.median(quality["spilled"] for quality in qualities),
        }

    def show(self, result: dict) -> None:
        out.print(f"{result['people']} people in {result['photographs']} photographs; left out: {left_out(result)}")
        out.print(f"the body covers {result['covered']:.0%} of a person, {result['spilled']:.0%} of it lies beside her")

    def following(self, result: dict) -> tuple[str, ...]:
        return ("train", "--people", self.people, *(("--images", str(self.images)) if self.images else ()))
