"""What makes the views of a training, whatever it is that they show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Int, UInt8
from torch import Tensor

from cloak_core.core.evaluation import NATURAL
from cloak_core.core.pattern import Pattern
from cloak_core.core.settings import TrainSettings
from cloak_core.core.view import BakedView
from cloak_core.files.errors import InputError
from cloak_core.files.identity import sha256_record

_CHOICE = 4
"""Stream of random numbers, apart from those of `sampling`."""


@dataclass(frozen=True, eq=False)
class Dealt:
    """What the images of a step must show; every column has length B."""

    step: int
    images: Int[np.ndarray, " B"]
    """Their numbers, counted from the start of the run."""
    member: Int[np.ndarray, " B"]
    """Of `Plan.members`."""
    direction: Int[np.ndarray, " B"]
    """Of `Plan.directions`."""


@runtime_checkable
class Plan(Protocol):
    """Decides whom images show, and from where."""

    directions: int
    """An epoch shows every background once in each direction: training angles, say."""
    members: int
    """Whom it shows, dealt out evenly: poses, say."""
    is_fresh: bool
    """Whether every image has a view of its own, so that keeping views gains nothing."""

    def draw(self, dealt: Dealt, random: np.random.Generator) -> dict[str, np.ndarray]:
        """Draw what the images of a step show: columns of length B. random: the step's generator."""
        ...


@runtime_checkable
class Source(Plan, Protocol):
    """Makes views. What an image shows is a function of its columns (`draw`), its seed and what is worn alone."""

    works_on: torch.device
    """What makes its views."""
    identity: str | None
    """SHA-256 (hex) of all that it shows beside what is worn; None where that is not known."""

    def view(self, shown: Mapping[str, int | float], seed: int | None, pattern: Pattern) -> BakedView:
        """Make one image's view, of its columns, with places on the faces that the pattern covers.

        seed: of the image; None: nothing is drawn at random, as judging has it.
        """
        ...

    def require_visible(self, pattern: Pattern) -> None:
        """Require that training can show what is worn. InputError: no view of its plan does."""
        ...


@runtime_checkable
class Backdrops(Protocol):
    """Images without people."""

    def __len__(self) -> int: ...

    def image(self, index: int, size: tuple[int, int]) -> UInt8[Tensor, "3 H W"]:
        """One of them, cut to (height, width)."""
        ...

    def identities(self) -> list[str]:
        """SHA-256 (hex) of each."""
        ...


class Mixture:
    """Two sources: the second is shown in a part of the images, `rate` of them on average; the first is dealt out."""

    def __init__(self, first: Source, second: Source, rate: float, seed: int) -> None:
        self.first = first
        self.second = second
        self.rate = rate
        self.seed = seed
        self.directions = first.directions
        self.members = first.members
        shown = second if rate == 1 else first
        self.is_fresh = shown.is_fresh
        # The CPU, where either that is shown needs it.
        self.works_on = second.works_on if second.works_on.type == "cpu" else shown.works_on

    @property
    def identity(self) -> str:
        """SHA-256 (hex) of both."""
        return sha256_record([self.first.identity, self.second.identity, self.rate, self.seed])

    def draw(self, dealt: Dealt, random: np.random.Generator) -> dict[str, np.ndarray]:
        """See `Source`. The second draws from streams of its own, so that the first draws as it does alone."""
        chosen = np.random.default_rng([self.seed, _CHOICE, dealt.step]).random(len(dealt.images)) < self.rate
        return self.first.draw(dealt, random) | self.second.draw(dealt, random) | {"second": chosen}

    def view(self, shown: Mapping[str, int | float], seed: int | None, pattern: Pattern) -> BakedView:
        """See `Source`."""
        return (self.second if shown["second"] else self.first).view(shown, seed, pattern)

    def require_visible(self, pattern: Pattern) -> None:
        """See `Source`."""
        if self.rate < 1:
            self.first.require_visible(pattern)
        self.second.require_visible(pattern)


class Cast:
    """Who is shown beside the bodies of a training, or in their place. This is nobody; a source's own cast overrides.

    It makes its own views and says for itself how a run records it.
    """

    identity: str | None = None
    """SHA-256 (hex) of all of them."""
    natural: tuple[str, ...] = NATURAL
    """Further controls of experiments: stripes and checks, which are drawn on bodies alone."""

    def __len__(self) -> int:
        return 0

    def first(self, count: int) -> Cast:
        """Take the first of them."""
        return self

    def preset(self, of_bodies: str = "best") -> str:
        """Name the preset of a training with them; of_bodies: the one that bodies alone would have."""
        return of_bodies

    def alone(self, settings: TrainSettings) -> TrainSettings:
        """Settings in which no bodies are shown. InputError: then nobody is."""
        raise InputError("--scene: none given, and no --people")

    def beside(self, bodies: Source, settings: TrainSettings, device: torch.device) -> Source:
        """Make what shows both, as often as the settings say."""
        return bodies

    def require_topology(self, topology: str) -> None:
        """Require that what is worn on faces of this topology can be shown. InputError."""

    def record(self) -> dict | None:
        """Describe by content and by name who is shown, for a run's config.json, so that others can be told apart."""
        return None

    def summary(self, key: str) -> dict[str, dict]:
        """Describe them under this key by their numbers and their content; {} of nobody."""
        return {}

    def halves(self) -> tuple[Cast, Cast]:
        """Part them into those who train and those who judge. InputError: they cannot be parted."""
        return self, self


NOBODY = Cast()
