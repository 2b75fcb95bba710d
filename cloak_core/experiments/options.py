"""The options of `cloak reproduce`, and which experiments there are; free of torch."""

from __future__ import annotations

from dataclasses import dataclass

from tyro.conf import UseAppendAction

from cloak_core.core.evaluation.settings import StoreOptions


@dataclass(frozen=True, kw_only=True)
class Options(StoreOptions):
    """How much an experiment does."""

    defence: UseAppendAction[tuple[str, ...]] = ()
    """Of `defences`: this one before the detector, jpeg=50 (default: seven)."""
    patterns: tuple[str, ...] = ()
    """Of `hardened`: published patterns on shirt and trousers: FILE.png (0.25 m wide) or FILE.png@tile=METRES."""


EXPERIMENTS = {
    "table1": "paper:TABLE1",
    "single-angle": "paper:SINGLE_ANGLE",
    "wide-angle": "paper:WIDE_ANGLE",
    "transfer": "paper:TRANSFER",
    "tv": "paper:TV",
    "distance": "paper:DISTANCE",
    "shape": "paper:SHAPE",
    "resolution": "paper:RESOLUTION",
    "ablation": "attacks:ABLATION",
    "render-gap": "render_gap:RENDER_GAP",
    "white-box": "attacks:WHITE_BOX",
    "closeness": "attacks:CLOSENESS",
    "defences": "defences:DEFENCES",
    "hardened": "defences:HARDENED",
}
"""MODULE:NAME of each below `declared`, in the order in which `all` runs them."""
