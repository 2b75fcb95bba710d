"""A cloth that repeats, in its colours: a run's, or any picture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8

from cloak_core.core.cloth import Cloth
from cloak_core.core.pictures import read_picture
from cloak_core.exchange.cloth import CLOTH_FILE, cloth_metres
from cloak_core.exchange.profiles import Profile
from cloak_core.files.errors import InputError


@dataclass(frozen=True, eq=False)
class PrintedCloth:
    """What is sewn into clothes, as fine as it is printed."""

    cloth: Cloth
    colors: Float32[np.ndarray, "S 3"]
    """Of its squares, in [0, 1]."""

    @classmethod
    def of(cls, picture: UInt8[np.ndarray, "h w 3"], metres: float) -> PrintedCloth:
        """Print a picture `metres` wide: a square for each of its pixels."""
        height, width = picture.shape[:2]
        return cls(Cloth(metres, width, height), picture.reshape(-1, 3).astype(np.float32) / 255)

    def printed(self, profile: Profile) -> PrintedCloth:
        """Give the cloth as it comes out of this printer and camera."""
        return replace(self, colors=profile.photographed(profile.to_send(self.colors)).astype(np.float32))


def cloth_of_run(folder: Path) -> PrintedCloth | None:
    """Read the cloth that a run trained; None where it trained colours of faces. InputError: it is damaged."""
    if not (folder / CLOTH_FILE).exists():
        return None
    return PrintedCloth.of(read_picture(folder / CLOTH_FILE), cloth_metres(folder))


def cloth_of_snapshot(folder: Path, colors: Path) -> PrintedCloth | None:
    """Read the cloth of a run's snapshot, the picture beside its colours; None where the run trained colours of faces.

    InputError: there is no such picture. Faces show less of a cloth than it has, so they say nothing of its success.
    """
    if not (folder / CLOTH_FILE).exists():
        return None
    picture = colors.with_suffix(".png")
    if not picture.exists():
        message = "no such file: this run's snapshots are of an earlier version, which kept the faces' colours alone"
        raise InputError(f"{picture}: {message}; train again with --snapshot-every")
    return PrintedCloth.of(read_picture(picture), cloth_metres(folder))
