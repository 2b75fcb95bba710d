"""Settings of `attack.pattern`: which colours there may be, and how finely they may change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.attack.settings.values import Bounds, Positive
from cloak_core.files.errors import InputError


@dataclass(frozen=True, kw_only=True)
class PatternSettings:
    """Which colours there may be, and how finely they may change."""

    colors_at_most: Annotated[int | None, Bounds(2, 256)] = None
    """End with at most so many distinct colours (inks, yarns, cloths): those of --palette (chosen among them where it
    has more), without one learnt. None leaves each face its own."""
    pattern: Literal["free", "camouflage", "tile"] = "free"
    """Where colours may change: from face to face, between patches no smaller than --feature-cm (camouflage), or
    between squares of --feature-cm of a cloth that repeats every --tile-cm all over the logo (tile)."""
    feature_cm: Annotated[float, Bounds(0, 100, "(]")] = 2.0
    """Of camouflage: the smallest patch, centimetres along the body in the first pose. Each has at least the area of
    a disc so wide."""
    tile_cm: Annotated[float, Bounds(0, 1000, "(]")] = 50.0
    """Of a cloth that repeats: its width and height, centimetres."""
    profile: str | None = None
    """Profile of a printer and a camera (`cloak calibrate`): training then sees, and keeps, the colours that come out
    of them; `cloak print --profile` writes those to send."""

    near: str | None = None
    """Stay close to a garment: #rrggbb, clothing (the first outfit), a picture as cloth (FILE.png@tile=0.5, metres),
    colours of this logo (.npy), a run of it or zoo:NAME."""
    within: Positive | None = None
    """How close: the largest mean CIEDE2000 of the faces from that garment's colours; about 1 is just visible."""
    within_most: Positive | None = None
    """The largest 95th percentile of it; None: twice the mean."""

    def check(self) -> None:
        """InputError: values that do not go together."""
        if (self.near is None) != (self.within is None):
            raise InputError("--near GARMENT and --within DE: one needs the other")
        if self.within_most is not None and self.near is None:
            raise InputError("--within-most: needs --near and --within")
        if self.near is not None and self.profile is not None:
            raise InputError("--near: says how colours are to look, --profile what comes out of a printer; give one")

    @property
    def on(self) -> bool:
        """Whether any of it is asked for."""
        return self.recolored or self.profile is not None or self.near is not None

    @property
    def recolored(self) -> bool:
        """Whether faces share colours."""
        return self.colors_at_most is not None or self.pattern != "free"
