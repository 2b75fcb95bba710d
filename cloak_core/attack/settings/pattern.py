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
    """End with at most this many distinct colours (inks, yarns, cloths): chosen from --palette, or learnt without one.
    None gives each face its own colour."""
    pattern: Literal["free", "camouflage", "tile"] = "free"
    """Where colours may change: free, from face to face; camouflage, between patches no smaller than --feature-cm;
    tile, between squares of --feature-cm in a cloth that repeats every --tile-cm."""
    feature_cm: Annotated[float, Bounds(0, 100, "(]")] = 2.0
    """Diameter of the smallest patch, centimetres along the body in the first pose."""
    tile_cm: Annotated[float, Bounds(0, 1000, "(]")] = 50.0
    """For --pattern tile: width and height of the cloth that repeats, centimetres."""
    profile: str | None = None
    """Profile of a printer and a camera (`cloak calibrate`): train the colours as they are photographed after printing;
    `cloak print --profile` writes the colours to send."""

    near: str | None = None
    """Stay close to a garment: #rrggbb, clothing (the first outfit), camouflage (a woodland print), a picture as cloth
    (FILE.png@tile=0.5, metres), colours of this logo (.npy), a run of it or zoo:NAME. With --pattern, to its mean in
    each patch or square."""
    within: Positive | None = None
    """With --near: largest mean CIEDE2000 between the faces and that garment; 1 is just visible."""
    within_most: Positive | None = None
    """With --near: largest 95th percentile of CIEDE2000; None: twice the mean."""

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
        recolored = self.colors_at_most is not None or self.pattern != "free"
        return recolored or self.profile is not None or self.near is not None
