"""The options of `cloak reproduce` and the names of the experiments, free of torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import UseAppendAction

from cloak_core.core.evaluation.settings import StoreOptions


@dataclass(frozen=True, kw_only=True)
class Options(StoreOptions):
    """How much an experiment does."""

    defence: UseAppendAction[tuple[str, ...]] = ()
    """Of `defences`: this one before the detector, jpeg=50 (default: seven)."""
    patterns: tuple[str, ...] = ()
    """Of `hardened`: published patterns on shirt and trousers: FILE.png (0.25 m wide) or FILE.png@tile=METRES."""


def names() -> tuple[str, ...]:
    """List the experiments by name: the declared modules, with dashes."""
    declared = Path(__file__).parent / "declared"
    return tuple(sorted(path.stem.replace("_", "-") for path in declared.glob("[!_]*.py")))
