"""A detector as one line of text, `FAMILY:WHAT@OPTIONS`, taken apart."""

import re
from dataclasses import dataclass

from cloak_core.files.errors import InputError
from cloak_core.files.specs import split_spec

PERSON = "person"
"""The class that is looked for unless told otherwise."""
OPTIONS = {"size": r"\d+(?:x\d+)?", "letterbox": "letterbox", "person": "person=[^,@]+"}
"""How each option after the @ is written; `parse_spec` says what becomes of it."""
_ANY = "|".join(OPTIONS.values())
_OPTIONS = re.compile(rf"^(?P<what>.*)@(?P<options>(?:{_ANY})(?:,(?:{_ANY}))*)$", re.DOTALL)


@dataclass(frozen=True)
class Request:
    """A spec taken apart, `darknet:a.cfg:a.weights@416,letterbox,person=cyclist`, and what is asked for beside it."""

    spec: str
    family: str
    what: str
    """All between the family and the options."""
    input_size: tuple[int, int] | None = None
    """The network's (height, width); None for the detector's own."""
    letterbox: bool = False
    person_class: str | None = None
    """Name or index of the class to look for; None where nobody said."""
    layout: str | None = None
    """Of a model's outputs, where the family has several."""
    fold: bool = True
    """Fold batch norm, and lay memory out for speed; False to measure against."""
    download: bool = False
    """Whether missing official weights may be fetched."""

    @property
    def parts(self) -> list[str]:
        """What stands between the colons after the family; nothing where there is nothing."""
        return split_spec(self.what) if self.what else []

    @property
    def person(self) -> str:
        """The class to look for."""
        return self.person_class or PERSON


def parse_spec(spec: str) -> Request:
    """Take a spec apart. InputError: an option given twice, a size of zero."""
    match = _OPTIONS.match(spec)
    what, options = (match["what"], match["options"].split(",")) if match else (spec, [])
    kinds = [_kind(option) for option in options]
    if len(set(kinds)) < len(kinds):
        raise InputError(f"detector {spec!r}: {max(kinds, key=kinds.count)} is given twice")
    given = dict(zip(kinds, options, strict=True))
    sides = [int(side) for side in given["size"].split("x")] if "size" in given else []
    family, _, what = what.partition(":")
    return Request(
        spec,
        family,
        what,
        input_size=(sides[0], sides[-1]) if sides else None,
        letterbox="letterbox" in given,
        person_class=given["person"].partition("=")[2] if "person" in given else None,
    )


def with_person_class(spec: str, person_class: str) -> str:
    """The spec of the same detector looking for that class, so that it can be loaded again from its spec alone."""
    if parse_spec(spec).person_class is not None:
        raise InputError(f"detector {spec!r}: says person= already; drop --person-class")
    return f"{spec}{',' if _OPTIONS.match(spec) else '@'}person={person_class}"


def _kind(option: str) -> str:
    return next(kind for kind, form in OPTIONS.items() if re.fullmatch(form, option))
