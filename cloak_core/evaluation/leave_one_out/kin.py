"""Which detectors are of one family, as far as their names tell."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from cloak_core.evaluation.report.words import short_name
from cloak_core.files.errors import InputError

SIBLING, STRANGER = "sibling", "stranger"
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
"""By what a name holds, the first that fits: all YOLOs count as kin, whoever made them."""


def family_of(spec: str) -> str:
    """A detector's family, from its spec: darknet:yolov3.cfg:... -> "yolo", onnx:nanodet_m.onnx -> "nanodet"."""
    name = short_name(spec).lower()
    for part, family in _FAMILIES.items():
        if part in name:
            return family
    last = name.split(" @")[0].rpartition(" ")[2]
    return (re.match(r"[a-z]+", last) or re.match(r".*", last))[0]


def families(specs: Iterable[str], told: Iterable[str] = ()) -> dict[str, str]:
    """Each detector's family by its spec; `told` are NAME=FAMILY, NAME a part of a spec. InputError: not so spelled, or
    no spec has it."""
    found = {spec: family_of(spec) for spec in specs}
    for words in told:
        name, mark, family = words.rpartition("=")
        meant = [spec for spec in found if name in spec]
        if not (name and mark and family and meant):
            raise InputError(f"--kin {words}: expected PART_OF_A_SPEC=FAMILY, of the detectors that are given")
        found |= dict.fromkeys(meant, family)
    return found


def kin(judged: str, surrogates: Iterable[str], family: Mapping[str, str]) -> str:
    """ "sibling" where a surrogate is of the judged detector's family, else "stranger"."""
    return SIBLING if family[judged] in {family[spec] for spec in surrogates} else STRANGER
