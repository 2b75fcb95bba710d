"""What the library's functions take, as it is or by name, and what they return."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

from cloak_core.core.detector.protocol import Detector
from cloak_core.core.source import NOBODY, Cast
from cloak_core.detectors.loading import Given, as_detector, as_detectors
from cloak_core.detectors.naming import full_spec
from cloak_core.exchange.bodies import Bodies
from cloak_core.sources.backdrops.backgrounds import Backgrounds, load_backgrounds
from cloak_core.sources.bodies.opening import load_scene

if TYPE_CHECKING:
    import pandas as pd

    from cloak_core.sources.photographs.people import People

T = TypeVar("T")
Named = str | os.PathLike
"""What the command line takes: a path, or a spec such as sample:train."""


def open_bodies(scene: Bodies | Named) -> Bodies:
    """Take bodies, or load them by name. InputError."""
    return scene if isinstance(scene, Bodies) else load_scene(scene)


def open_backgrounds(backgrounds: Backgrounds | Named) -> Backgrounds:
    """Take backgrounds, or load them by name. InputError."""
    return backgrounds if isinstance(backgrounds, Backgrounds) else load_backgrounds(backgrounds)


def cast_of(people: People | Named | None, images: Named | None = None) -> Cast:
    """Make what shows people in photographs: loaded ones, or those of a COCO file; None: nobody. InputError."""
    if people is None:
        return NOBODY
    # Whoever shows bodies alone needs nothing of photographs.
    from cloak_core.sources.photographs.crowd import Crowd
    from cloak_core.sources.photographs.people import load_people

    return Crowd(load_people(people, images) if isinstance(people, Named) else people)


def by_name(detectors: Mapping[str, Given] | Given | Sequence[Given], device: str) -> dict[str, Detector]:
    """Make detectors of what is given, by the names in a mapping, else by their specs."""
    if isinstance(detectors, Mapping):
        return {name: as_detector(detector, device) for name, detector in detectors.items()}
    several = detectors if isinstance(detectors, (list, tuple)) else [detectors]
    made = as_detectors(several, device)
    return {full_spec(one) if isinstance(one, str) else d.spec: d for one, d in zip(several, made, strict=True)}


def made_settings(settings: T | None, changes: dict, make: Callable[..., T]) -> T:
    """Take the settings, or make them by the changes. TypeError: both are given."""
    if settings is not None and changes:
        raise TypeError(f"settings are given: change {', '.join(changes)} there")
    return make(**changes) if settings is None else settings


# --- what they return

COLUMNS = ("success", "success_own", "success_iou", "conditional", "renamed", "gone", "ap50", "n")
"""Figures of an S of contract C6 that are one number each."""


class Figures(dict):
    """The record that `cloak evaluate --json` or `cloak wear --json` prints, with its rates as a table."""

    def to_frame(self) -> pd.DataFrame:
        """Make a table with a row for each detector and what is worn: rates in [0, 1], bounds of the 95 % interval, n.

        "logo" are the colours that were judged; "clothing", "grey", "random" and the like are controls.
        """
        import pandas as pd

        rows = []
        for spec, judged in self["detectors"].items():
            for worn, rates in judged.items():
                if isinstance(rates, dict) and "success" in rates and "ci95" in rates:
                    low, high = rates["ci95"]
                    row = {"detector": spec, "worn": worn, "low": low, "high": high}
                    rows.append(row | {name: rates[name] for name in COLUMNS if name in rates})
        return pd.DataFrame(rows)
