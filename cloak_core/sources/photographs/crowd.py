"""People in photographs as they are handed to trainings and evaluations: fitted, recorded, and made into images."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property

import numpy as np
import pandas as pd
import torch

from cloak_core.core.evaluation.settings import WearSettings
from cloak_core.core.images import ImageSet
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings import TrainSettings
from cloak_core.core.source import Cast, Mixture, Source
from cloak_core.files.errors import InputError
from cloak_core.sources.backdrops.backgrounds import Backgrounds, Picture
from cloak_core.sources.photographs.fits import UNCOVERED, Fits, fit_people, people_identity, those_who_fit
from cloak_core.sources.photographs.people import People
from cloak_core.sources.photographs.posing import seen_from
from cloak_core.sources.photographs.rig import body_rig, faces_on_rig
from cloak_core.sources.photographs.source import PeopleSource
from cloak_core.sources.photographs.views import logo_positions


class Crowd(Cast):
    """Annotated people, fitted when somebody asks for their views. InputError: the body fits none of them."""

    natural = ()

    def __init__(self, people: People, fits: Fits | None = None) -> None:
        """fits: of those whom the body fits, where they are known."""
        self.people = people
        if fits is not None:
            self.fits = fits

    def __len__(self) -> int:
        return len(self.people)

    @cached_property
    def identity(self) -> str:
        """See `Cast`."""
        return people_identity(self.people)

    @cached_property
    def fits(self) -> Fits:
        """The fits of those whom the body fits."""
        return fit_people(self.people)

    def first(self, count: int) -> Crowd:
        """See `Cast`."""
        return Crowd(replace(self.people, people=self.people.people[:count]))

    # --- in a training

    def preset(self, of_bodies: str = "best") -> str:
        """See `Cast`."""
        return "photographs"

    def alone(self, settings: TrainSettings) -> TrainSettings:
        """See `Cast`."""
        return settings.changed(people_share=1.0)

    def beside(self, bodies: Source, settings: TrainSettings, device: torch.device) -> Mixture:
        """See `Cast`."""
        people = PeopleSource(self.fits, settings.views.size, settings.run.seed, device=device)
        return Mixture(bodies, people, settings.photographs.people_share, settings.run.seed)

    def require_topology(self, topology: str) -> None:
        """See `Cast`."""
        faces_on_rig(topology)

    def record(self) -> dict:
        """See `Cast`."""
        people = self.fits.people
        photographs = {person.photograph: person for person in people}.values()
        return {
            "count": len(people),
            "photographs": [person.photograph for person in photographs],
            "licences": [person.licence for person in photographs],
            "pixels": [person.pixels for person in photographs],
            "looks": [person.look for person in photographs],
            "identity": people_identity(people),
        }

    def summary(self, key: str) -> dict[str, dict]:
        """See `Cast`."""
        counts = {"count": len(self), "photographs": len(self.people.photographs)}
        return {key: counts | {"sha256": self.identity}}

    def halves(self) -> tuple[Crowd, Crowd]:
        """See `Cast`: the people of every second photograph, and those of the others."""
        first, second = self.people.halves()
        return Crowd(first), Crowd(second)

    # --- in an evaluation

    def wearers(self, patterns: Iterable[Pattern]) -> Crowd:
        """Leave out whom the body does not fit, and on whom one of the cloths shows nowhere.

        InputError: nobody is left.
        """
        fitting = those_who_fit(self.people, self.fits)
        cloths = {pattern.cover.key: pattern.cover for pattern in patterns if pattern.period}.values()
        positions = [logo_positions(cover.topology, cover.face_ids) for cover in cloths]
        dressed = [all((position[fit.main] >= 0).any() for position in positions) for fit in self.fits]
        if dressed and not any(dressed):
            raise InputError(f"{self.people.name}: {' or '.join(cover.name for cover in cloths)} shows on nobody")
        fits = self.fits.where(dressed)
        return Crowd(those_who_fit(fitting, fits, UNCOVERED), fits)

    def images(self, backgrounds: Backgrounds, settings: WearSettings, device: torch.device | str = "cpu") -> ImageSet:
        """Make an image of each fitted person, and of backgrounds without people."""
        people, rig = self.fits.people, body_rig()
        trials = pd.DataFrame(
            {
                "pose": np.arange(len(people)),
                "photograph": [person.photograph for person in people],
                "seen_from": [seen_from(person.landmarks, rig) for person in people],
            }
        )
        source = PeopleSource(self.fits, settings.size, context=settings.context, device=device)
        size = settings.size, settings.size
        names = tuple(person.name for person in people)
        return ImageSet(source, backgrounds, size, device, trials, names, tuple(backgrounds.names))

    def quality(self) -> dict[str, float]:
        """Average how well they fit (`Fit.quality`)."""
        qualities = list(self.fits.qualities())
        return {key: round(float(np.mean([one[key] for one in qualities])), 4) for key in sorted(qualities[0])}

    def pictures(self) -> dict[str, Picture]:
        """Say what their photographs are, by file name."""
        return {person.photograph: Picture(person.pixels, person.look) for person in self.people}
