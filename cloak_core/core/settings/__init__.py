"""Everything that decides how a logo is trained: the settings of each component, and five presets of them all.

`paper` is the paper's text, `reference` its published code, `best` what this project measured to work best against the
detectors that it trains on, `transfer` its recipe for those that training never saw, `photographs` the one for people
in photographs.

Settings have values (a range, angles, a choice), options and files have text. A preset, a TOML file and flags are
merged as they come, then checked once, when the `TrainSettings` is made: InputError names the option. To a user the
settings are flat, by the names of the flags; so they are in config.json. The components' code imports torch, their
settings do not: `cloak train --help` is to be quick.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Literal

from cloak_core.core.settings.components import (
    AugmentationSettings,
    ComputeSettings,
    LossSettings,
    OptimizerSettings,
    PatternSettings,
    PeopleSettings,
    QuerySettings,
    RunSettings,
    SurrogateSettings,
    ViewSettings,
)
from cloak_core.core.settings.retired import without_retired
from cloak_core.core.settings.values import Bounds, Parsable, from_plain, option
from cloak_core.files.errors import InputError

Preset = Literal["paper", "reference", "best", "transfer", "photographs"]


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """How to train. The defaults are preset `paper`; `make_settings` starts from any preset."""

    preset: Preset = "paper"
    """Where the settings come from."""
    run: RunSettings = field(default_factory=RunSettings)
    """How long it is, and what it keeps."""
    views: ViewSettings = field(default_factory=ViewSettings)
    """What the rendered images show of the body."""
    augmentation: AugmentationSettings = field(default_factory=AugmentationSettings)
    """What makes every image another one."""
    photographs: PeopleSettings = field(default_factory=PeopleSettings)
    """How photographs of people are shown."""
    objective: LossSettings = field(default_factory=LossSettings)
    """What training minimises."""
    pattern: PatternSettings = field(default_factory=PatternSettings)
    """Which colours there may be, and how finely they may change."""
    surrogates: SurrogateSettings = field(default_factory=SurrogateSettings)
    """What makes many of each detector."""
    optimization: OptimizerSettings = field(default_factory=OptimizerSettings)
    """How the colours begin and move."""
    queries: QuerySettings = field(default_factory=QuerySettings)
    """How a detector is asked that gives no gradient."""
    compute: ComputeSettings = field(default_factory=ComputeSettings)
    """Where to compute."""

    def __post_init__(self) -> None:
        for name in COMPONENTS:
            check_settings(getattr(self, name))
        translation, size = self.augmentation.translation, self.views.size
        if 2 * translation >= size:
            raise InputError(f"--translation: {translation} px would move the body out of {size} px images")

    def changed(self, **changes: object) -> TrainSettings:
        """Copy with other values, by the names of the flags."""
        return settings_from_record(settings_record(self) | changes)

    def epoch_images(self, background_count: int) -> int:
        """Count the images in one epoch: every background at every training angle (or ten degrees of a range)."""
        return background_count * len(self.views.angles.starts)

    def total_steps(self, background_count: int) -> int:
        """Count the updates of the whole run; the last one may hold fewer images than a batch."""
        if self.run.steps is not None:
            return self.run.steps
        return max(1, math.ceil(self.run.epochs * self.epoch_images(background_count) / self.run.batch))


COMPONENTS: dict[str, type] = {
    entry.name: entry.default_factory for entry in dataclasses.fields(TrainSettings) if entry.name != "preset"
}
"""Of `TrainSettings`, by the name of the field."""
_MANY_DETECTORS: dict[str, object] = {
    "batch": 4,
    "angles": "0..360",
    "elevation": "0:30",
    "distance": "1.4:6",
    "contrast": "0.8:1.2",
    "brightness": "-0.1:0.1",
    "crop": 0.15,
    "pad": 0.3,
    "loss": "margin",
    "ensemble": "adaptive",
    "detectors_per_step": 1,
    "optimizer": "adam",
    "schedule": "cosine",
}
"""Shared by the presets for detectors that training never sees: bodies all around, near and far, and changed images."""
PRESETS: dict[str, dict[str, object]] = {
    "paper": {},
    "reference": {
        "elevation_jitter": 0.09,
        "translation": 25,
        "translation_per": "batch",
        "contrast": "0.8:1.2",
        "brightness": "-0.1:0.1",
        "loss": "objectness",
        "lr": 1e-2 / math.sqrt(8),
        "momentum": 0.9,
        "schedule": "constant",
    },
    "best": {
        "steps": 600,
        "contrast": "0.8:1.2",
        "brightness": "-0.1:0.1",
        "loss": "margin",
        "optimizer": "adam",
        "lr": 0.05,
        "schedule": "cosine",
    },
    "transfer": _MANY_DETECTORS
    | {
        "steps": 1500,
        "cutout": 0.3,
        "smooth": 8,
        "initial": "animal",
        "lr": 0.05,
    },
    "photographs": _MANY_DETECTORS
    | {
        "steps": 300,
        "noise": 0.05,
        "people_share": 1.0,
        "pattern": "tile",
        "tile_cm": 25.0,
        "feature_cm": 0.25,
        "gamut": "sigmoid",
        "octaves": 5,
        "initial": "balls",
        "initial_share": 0.5,
        "lr": 0.05,
    },
}
"""What each preset changes of the defaults. The reference's learning rate is its 1e-2 / sqrt(batch) at batch 8."""


def merge(*layers: Mapping[str, object]) -> dict[str, object]:
    """Merge a preset (the one that the last layer names, else "best") and layers upon it, as plain values.

    Later ones win; `steps` replaces the `epochs` of earlier ones and the other way round. InputError: unknown preset.
    """
    preset = next((layer["preset"] for layer in reversed(layers) if "preset" in layer), "best")
    if not isinstance(preset, str) or preset not in PRESETS:
        raise InputError(f"--preset: {preset!r} is not one of {', '.join(PRESETS)}")
    merged: dict[str, object] = {}
    for layer in (PRESETS[preset], *layers, {"preset": preset}):
        for named, replaced in (("steps", "epochs"), ("epochs", "steps")):
            if layer.get(named) is not None and layer.get(replaced) is None:
                merged[replaced] = None
        merged |= {key: value for key, value in layer.items() if value is not None or key not in ("steps", "epochs")}
    return merged


def make_settings(preset: object = "best", **changes: object) -> TrainSettings:
    """Make settings of a preset with changes by name, in the right types (7 becomes 7.0 where a number is meant).

    `steps` replaces the preset's `epochs` and the other way round. Unknown names, wrong types and bad values raise
    `InputError` naming the option.
    """
    return settings_from_record(merge(changes | {"preset": preset}))


def settings_from_record(record: Mapping[str, object]) -> TrainSettings:
    """Make settings from plain values as JSON or TOML give them; names that are missing keep the default.

    Options that earlier versions had (`retired`) may be there as long as they are off.
    """
    return TrainSettings(**components_from_record(record))


def components_from_record(record: Mapping[str, object]) -> dict[str, object]:
    """Make what `TrainSettings` takes, of the right types, but not checked whether they go together."""
    known = _kinds()
    record = without_retired(dict(record))
    unknown = sorted(set(record) - set(known))
    if unknown:
        raise InputError(f"{option(unknown[0])}: no such setting (known: {', '.join(known)})")
    by_component: dict[str, dict] = {name: {} for name in (*COMPONENTS, "")}
    for name, value in record.items():
        component, kind = known[name]
        by_component[component][name] = from_plain(name, value, kind)
    return by_component.pop("") | {name: COMPONENTS[name](**values) for name, values in by_component.items()}


def settings_record(settings: TrainSettings) -> dict[str, object]:
    """Record settings as flat plain values for JSON; `settings_from_record` reads them back."""
    values = {"preset": settings.preset}
    for name in COMPONENTS:
        values |= vars(getattr(settings, name))
    return {name: str(value) if isinstance(value, Parsable) else value for name, value in values.items()}


def check_settings(settings: object) -> None:
    """Check a component. InputError: a field out of its annotation's bounds, or fields that do not go together."""
    for name, kind in hints_of(type(settings)).items():
        value = getattr(settings, name)
        for bounds in getattr(kind, "__metadata__", ()):
            if isinstance(bounds, Bounds) and value not in bounds:
                raise InputError(f"{option(name)}: {value} is not in {bounds}")
    if hasattr(settings, "check"):
        settings.check()


@cache
def hints_of(component: type) -> dict[str, object]:
    """Read what a dataclass declares, by the name of the field, with what stands in the annotation."""
    return typing.get_type_hints(component, include_extras=True)


@cache
def _kinds() -> dict[str, tuple[str, object]]:
    """Find each setting's component ("" for the preset) and its type, by its name."""
    own = {"preset": ("", Preset)}
    return own | {n: (name, kind) for name, cls in COMPONENTS.items() for n, kind in hints_of(cls).items()}
