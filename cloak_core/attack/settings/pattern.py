"""Settings of `attack.pattern`: which colours there may be, and how finely they may change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cloak_core.attack.settings.values import Within


@dataclass(frozen=True, kw_only=True)
class PatternSettings:
    """Which colours there may be, and how finely they may change."""

    colors_at_most: Annotated[int | None, Within(2, 256)] = None
    """End with at most so many distinct colours (inks, yarns, cloths): those of --palette (chosen among them where it
    has more), without one learnt. None leaves each face its own."""
    pattern: Literal["free", "camouflage"] = "free"
    """Where colours may change: from face to face, or between patches no smaller than --feature-cm (camouflage)."""
    feature_cm: Annotated[float, Within(0, 100, "(]")] = 2.0
    """Of camouflage: the smallest patch, centimetres along the body in the first pose. Each has at least the area of
    a disc so wide."""
    profile: str | None = None
    """Profile of a printer and a camera (`cloak calibrate`): training then sees, and keeps, the colours that come out
    of them; `cloak print --profile` writes those to send."""

    @property
    def on(self) -> bool:
        """Whether any of it is asked for."""
        return self.colors_at_most is not None or self.pattern != "free" or self.profile is not None
