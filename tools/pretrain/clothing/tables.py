"""The tables behind the clothed people: who, in which motion, in which folds. All made by hand."""

from __future__ import annotations

from dataclasses import dataclass, field

from cloak_core.core.cameras import Number
from tools.pretrain.body_tables import shape

PEOPLE = {
    "p1": shape(0.05, 0.68, 0.55, 0.50, 0.36),
    "p2": shape(0.95, 0.67, 0.50, 0.47, 0.36, cupsize=0.5),
    "p3": shape(0.15, 0.78, 0.50, 0.74, 0.38),
    "p4": shape(0.85, 0.84, 0.45, 0.62, 0.34, asian=0.8, african=0.1, caucasian=0.2),
    "u1": shape(0.08, 0.77, 0.62, 0.56, 0.43, proportions=0.62),
    "u2": shape(0.9, 0.70, 0.60, 0.42, 0.41, cupsize=0.4, asian=0.6, caucasian=0.5, african=0.1),
    "u3": shape(0.4, 0.86, 0.45, 0.68, 0.30, caucasian=0.9, african=0.2, asian=0.2),
}
"""Anny's phenotypes; those of u are unseen."""


@dataclass(frozen=True)
class Clip:
    """One looped cycle of one person in one drape of the garments."""

    motion: str
    person: str
    wrinkles: int
    """Seed of the folds: where the cloth is wider, how stiff it is, how it begins."""
    frames: int
    """Frames that are kept, evenly over the cycle."""
    seconds: float
    """Of one cycle."""
    fine: int = 1
    """Frames of the solver for each that is kept; fast legs leave their trousers where there are too few."""
    hold: float = 0.0
    """How firmly trousers keep to the legs (`blender/inside.py`'s weight of a pin)."""
    style: dict[str, Number] = field(default_factory=dict)
    """Arguments of the motion."""

    @property
    def name(self) -> str:
        return f"{self.motion}-{self.person}-w{self.wrinkles}"

    @property
    def unseen(self) -> bool:
        return self.person.startswith("u")


CLIPS = (
    Clip("walking", "p1", 1, 16, 1.05),
    Clip("walking", "p1", 2, 16, 1.05),
    Clip("walking", "p2", 3, 16, 1.0, style={"reach": 0.9, "swing": 26.0}),
    Clip("running", "p3", 4, 12, 0.74, fine=3, hold=0.55, style={"reach": 0.85, "drive": 26.0, "lean": 5.0}),
    Clip("standing", "p4", 5, 8, 1.6, fine=3),
    Clip("walking", "u1", 11, 16, 1.0, style={"reach": 1.1, "swing": 28.0, "lean": 3.0}),
    Clip("running", "u2", 12, 12, 0.74, fine=3, hold=0.55, style={"reach": 0.95, "drive": 36.0, "lean": 8.0}),
    Clip("waving", "u3", 13, 12, 0.9, style={"raised": 92.0, "right": False}),
    Clip("standing", "u1", 14, 8, 1.6, fine=3, style={"sway": 1.2, "elbow": 34.0}),
)
"""Training's people first, then the unseen ones; waving is never trained on."""
