"""What a leave-one-out matrix trains: families of detectors, ablations of the recipe, and where cameras stand."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from cloak_core.evaluation.report.words import short_name
from cloak_core.evaluation.statistics_card import KINSHIPS
from cloak_core.files.errors import InputError

# --- which detectors are of one family

SAME_FAMILY, CROSS_FAMILY = KINSHIPS
_FAMILIES = {
    "yolo": "yolo",
    "rtdetr": "detr",
    "rt-detr": "detr",
    "detr": "detr",
    "d-fine": "detr",
    "dfine": "detr",
    "rcnn": "rcnn",
    "d2go": "rcnn",
}
"""By what a name holds, the first that fits: all YOLOs are of one family, whoever made them."""


def family_of(spec: str) -> str:
    """Read a detector's family from its spec: darknet:yolov3.cfg:... -> "yolo", onnx:nanodet_m.onnx -> "nanodet"."""
    name = short_name(spec).lower()
    for part, family in _FAMILIES.items():
        if part in name:
            return family
    last = name.split(" @")[0].rpartition(" ")[2]
    return (re.match(r"[a-z]+", last) or re.match(r".*", last))[0]


def families(specs: Iterable[str], told: Iterable[str] = ()) -> dict[str, str]:
    """Find each detector's family by its spec; `told` are NAME=FAMILY, NAME a part of a spec.

    InputError: not so spelled, or no spec has it.
    """
    found = {spec: family_of(spec) for spec in specs}
    for words in told:
        name, mark, family = words.rpartition("=")
        meant = [spec for spec in found if name in spec]
        if not (name and mark and family and meant):
            raise InputError(f"--kin {words}: expected PART_OF_A_SPEC=FAMILY, of the detectors that are given")
        found |= dict.fromkeys(meant, family)
    return found


def kinship(judged: str, surrogates: Iterable[str], family: Mapping[str, str]) -> str:
    """Tell whether a surrogate is of the judged detector's family: `SAME_FAMILY` or `CROSS_FAMILY`."""
    return SAME_FAMILY if family[judged] in {family[spec] for spec in surrogates} else CROSS_FAMILY


# --- ablations: from preset `best` to the recipe, each technique alone, and one upon the other

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
"""What each ablation changes of preset `best`, in order; up to `cutout` they are the recipe."""
ALONE: dict[str, dict[str, object]] = {"score": {"loss": "score"}}
"""Ablations that are no step of the ladder: steps back from `best`."""
BASE, RECIPE, ALL = "best", "recipe", "ladder"


def ablation_names(asked: Sequence[str]) -> tuple[str, ...]:
    """List the ablations' names, `ladder` spelled out. InputError: no such ablation."""
    whole = (BASE, *ALONE, *LADDER, *(f"+{name}" for name in list(LADDER)[1:]), RECIPE)
    found = tuple(dict.fromkeys(name for one in asked for name in (whole if one == ALL else (one,))))
    for name in found:
        if name not in whole:
            known = ", ".join((BASE, *ALONE, *LADDER, RECIPE, ALL))
            raise InputError(f"--rungs: {name!r} is not one of {known}; +NAME is all up to NAME")
    return found


def ablation_settings(name: str, photographs: bool = False) -> dict[str, object]:
    """Make the training settings of `best`, a technique alone upon it, +NAME (all up to it), or `recipe`.

    photographs: whether training sees people in photographs, for whom the recipe is another.
    """
    if name == RECIPE:
        return {"preset": "photographs" if photographs else "transfer"}
    settings: dict[str, object] = {"preset": "best"}
    if not name.startswith("+"):
        return settings | (LADDER | ALONE).get(name, {})
    steps = list(LADDER)
    for step in steps[: steps.index(name[1:]) + 1]:
        settings |= LADDER[step]
    return settings


# --- cameras


@dataclass(frozen=True)
class Cameras:
    """Where cameras stand, in training and in the test."""

    training: Mapping[str, object]
    """Training settings by name."""
    angles: tuple[float, ...]
    """Test azimuths, degrees."""
    test: Mapping[str, object]
    """Further evaluation settings by name."""


FRONT = Cameras({"angles": "-10:10:5", "elevation": 6, "distance": 2.2}, tuple(map(float, range(-10, 11, 4))), {})
PHOTOGRAPHS = Cameras({}, (), {})
"""Photographs stand where they were taken, and the recipe for them says where cameras of renders stand."""
CIRCLE = Cameras(
    {"angles": "0..360", "elevation": "0:30", "distance": "1.4:6"},
    tuple(map(float, range(0, 360, 10))),
    {"elevations": (0.0, 15.0, 30.0), "distances": (1.4, 2.2, 4.0, 6.0)},
)
