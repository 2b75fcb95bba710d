"""How much is trained and evaluated, and where results are kept: one dataclass, free of torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

from tyro.conf import Suppress, UseAppendAction

from cloak_core.attack.settings import Preset

QUICK_STEPS = 150
T = TypeVar("T")
Internal = Annotated[T, Suppress]
"""Set by programs, not an option of a command."""


@dataclass(frozen=True, kw_only=True)
class StoreOptions:
    """How much is trained and evaluated, and where results are kept."""

    out: Path = Path("runs/reproduce")
    """Folder for results and shared trainings; what is there already is not done again."""
    quick: bool = False
    """Fewer steps, angles, images and seeds: the whole set within 90 minutes on two cores."""
    preset: Preset = "best"
    """Training preset."""
    steps: UseAppendAction[tuple[int, ...]] = ()
    """Updates of a training, once for all or once for each --detector, in their order (default: 150 with --quick, else
    what the preset says)."""
    seeds: int | None = None
    """Repetitions of every training, each with another seed (default: 1 with --quick, else 3)."""
    seed: int = 0
    """Every random draw derives from it; repetitions count on from it."""
    batch: Internal[int | None] = None
    """Images per update; None: what the preset says."""
    images_per_view: Internal[int | None] = None
    """Test images per body and angle; None: 2 when quick, else 8."""
    size: Internal[int] = 416
    """Width and height of the images, pixels."""
    samples: Internal[int | None] = None
    """Samples per pixel; None takes the renderer's default."""
    device: Internal[str] = "cpu"
    """Torch device."""
    command: Internal[str] = ""
    """The command line that asked for it, for the record."""

    @property
    def seed_list(self) -> tuple[int, ...]:
        """The seed of each repetition."""
        return tuple(range(self.seed, self.seed + (self.seeds or (1 if self.quick else 3))))

    @property
    def test_images(self) -> int:
        """Test images per body and angle."""
        return self.images_per_view or (2 if self.quick else 8)

    def counts(self) -> dict:
        """Describe the amount for a record: steps, seeds, images per view, quick."""
        length = QUICK_STEPS if self.quick else f"as in preset {self.preset}"
        if self.steps:
            length = self.steps[0] if len(self.steps) == 1 else " / ".join(map(str, self.steps)) + " by detector"
        return {"steps": length, "seeds": len(self.seed_list), "images_per_view": self.test_images, "quick": self.quick}
