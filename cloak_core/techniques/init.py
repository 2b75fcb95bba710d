"""Beginning with the colours of an earlier run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from cloak_core.core.technique import Setup, Technique
from cloak_core.files.identity import sha256_arrays


@dataclass(frozen=True, kw_only=True)
class InitSettings:
    init: str | None = None
    """Begin with these colours instead: a run folder of the same logo, zoo:NAME, or colours [L, 3] (`cloak logo
    transfer`)."""


class Init(Technique):
    """Gives the first colours of the logo's faces."""

    group = "optimization"
    settings = InitSettings
    files = (("init", "start"),)
    order = -1  # the other colours are told by it

    def __init__(self, colors: Float32[np.ndarray, "L 3"]) -> None:
        self.colors = colors

    @classmethod
    def build(cls, setup: Setup) -> Init | None:
        """InputError: the colours cannot be read, or are of another logo."""
        from cloak_core.zoo.starting import read_start

        path = setup.settings.optimization.init
        return None if path is None else cls(read_start(Path(path), setup.pattern.cover))

    def first(self) -> Float32[np.ndarray, "L 3"]:
        return self.colors

    def content(self) -> dict[str, object]:
        return {"start": {"sha256": sha256_arrays(self.colors)}}


TECHNIQUE = Init
