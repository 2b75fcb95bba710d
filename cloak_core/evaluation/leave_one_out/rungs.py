"""The ladder from preset `best` to the recipe: each technique alone, and one upon the other."""

from __future__ import annotations

from collections.abc import Sequence

from cloak_core.files.errors import InputError

LADDER: dict[str, dict[str, object]] = {
    "smooth": {"smooth": 8},
    "animal": {"initial": "animal"},
    "window": {"crop": 0.15, "pad": 0.3},
    "adaptive": {"ensemble": "adaptive"},
    "cutout": {"cutout": 0.3},
    "quality": {"blur": 1.0, "jpeg": "50:95"},
    "shake": {"shake": 0.3},
    "depth": {"random_depth": 0.1},
    "noise": {"activation_noise": 0.1},
    "colour": {"tint": 0.2},
    "background": {"background_mix": 0.3},
    "sharpness": {"sharpness": 0.02, "ascent": "momentum"},
    "mi": {"optimizer": "mi", "momentum": 0.9, "lr": 0.02},
    "views": {"angles": "-20..20", "elevation": "0:20", "distance": "1.8:3.5"},
}
"""What each rung changes of preset `best`, in order; up to `cutout` they are the recipe."""
ASIDE: dict[str, dict[str, object]] = {"score": {"loss": "score"}}
"""Rungs that stand alone: steps back from `best`."""
BASE, RECIPE, ALL = "best", "recipe", "ladder"


def names(asked: Sequence[str]) -> tuple[str, ...]:
    """The rungs' names, `ladder` spelled out. InputError: no such rung."""
    whole = (BASE, *ASIDE, *LADDER, *(f"+{name}" for name in list(LADDER)[1:]), RECIPE)
    found = tuple(dict.fromkeys(name for one in asked for name in (whole if one == ALL else (one,))))
    for name in found:
        if name not in whole:
            known = ", ".join((BASE, *ASIDE, *LADDER, RECIPE, ALL))
            raise InputError(f"--rungs: {name!r} is not one of {known}; +NAME is all up to NAME")
    return found


def changes(name: str) -> dict[str, object]:
    """The training settings of a rung: `best`, a technique alone upon it, +NAME (all up to it), or `recipe`."""
    if name == RECIPE:
        return {"preset": "transfer"}
    if not name.startswith("+"):
        return {"preset": "best"} | (LADDER | ASIDE).get(name, {})
    settings: dict[str, object] = {"preset": "best"}
    for own, change in LADDER.items():
        settings |= change
        if own == name[1:]:
            break
    return settings
