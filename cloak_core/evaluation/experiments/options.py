"""How much the experiments do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

from tyro.conf import Suppress, UseAppendAction

from cloak_core.attack.settings import Preset

QUICK_STEPS = 150
T = TypeVar("T")
Own = Annotated[T, Suppress]
"""Set by programs, and no option of the command."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """How much an experiment does."""

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
    defence: UseAppendAction[tuple[str, ...]] = ()
    """Of `defences`: these, as they stand before a detector, jpeg=50 (default: seven of them)."""
    batch: Own[int | None] = None
    """Images per update; None: what the preset says."""
    images_per_view: Own[int | None] = None
    """Test images per body and angle; None: 2 when quick, else 8."""
    size: Own[int] = 416
    """Width and height of the images, pixels."""
    samples: Own[int | None] = None
    """Samples per pixel; None takes the renderer's default."""
    device: Own[str] = "cpu"
    """Torch device."""
    command: Own[str] = ""
    """The command line that asked for it, for the record."""

    @property
    def seed_list(self) -> tuple[int, ...]:
        return tuple(range(self.seed, self.seed + (self.seeds or (1 if self.quick else 3))))

    @property
    def test_images(self) -> int:
        return self.images_per_view or (2 if self.quick else 8)

    def counts(self) -> dict:
        """What "quick" and the options came to, for the record."""
        length = QUICK_STEPS if self.quick else f"as in preset {self.preset}"
        if self.steps:
            length = self.steps[0] if len(self.steps) == 1 else " / ".join(map(str, self.steps)) + " by detector"
        return {"steps": length, "seeds": len(self.seed_list), "images_per_view": self.test_images, "quick": self.quick}
