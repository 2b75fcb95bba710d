"""A detector as one line of text, `FAMILY:WHAT@OPTIONS`, taken apart."""

import re
from dataclasses import dataclass

from cloak_core.files.errors import InputError

PERSON = "person"
"""The class that is looked for unless told otherwise."""
_OPTION = r"(?:\d+(?:x\d+)?|letterbox|person=[^,@]+)"
_OPTIONS = re.compile(rf"^(?P<rest>.*)@(?P<options>{_OPTION}(?:,{_OPTION})*)$", re.DOTALL)


@dataclass(frozen=True)
class Spec:
    """What a spec says: `darknet:a.cfg:a.weights@416,letterbox,person=pedestrian`."""

    family: str
    rest: str
    """All between the family and the options."""
    size: tuple[int, int] | None
    """The network's input (height, width); None for the detector's own."""
    letterbox: bool
    person_class: str | None
    """Name or index of the class to look for; None where the spec does not say."""


def parse_spec(spec: str) -> Spec:
    """Take a spec apart. InputError: an option given twice."""
    match = _OPTIONS.match(spec)
    rest, options = (match["rest"], match["options"].split(",")) if match else (spec, [])
    kinds = [_kind(option) for option in options]
    if len(set(kinds)) < len(kinds):
        raise InputError(f"detector {spec!r}: {max(kinds, key=kinds.count)} is given twice")
    given = dict(zip(kinds, options, strict=True))
    sides = [int(side) for side in given["size"].split("x")] if "size" in given else []
    family, _, rest = rest.partition(":")
    person = given["person"].partition("=")[2] if "person" in given else None
    return Spec(family, rest, (sides[0], sides[-1]) if sides else None, "letterbox" in given, person)


def with_person_class(spec: str, person_class: str) -> str:
    """The spec of the same detector looking for that class, so that it can be loaded again from its spec alone."""
    if parse_spec(spec).person_class is not None:
        raise InputError(f"detector {spec!r}: says person= already; drop --person-class")
    return f"{spec}{',' if _OPTIONS.match(spec) else '@'}person={person_class}"


def _kind(option: str) -> str:
    return option.partition("=")[0] if not option[0].isdigit() else "size"
